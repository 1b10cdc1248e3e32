// Averages a payload with the weights of the candidates: adds up Σ w·(l_q − l_p) for every plane l of the payload. The
// weights of a chunk of offsets are those that candidate_accumulate has left behind its running sums (WEIGHTS), so
// that they are computed once for any number of layers.
//
// LARGE, SMALL and FEATURES_ALONE name the filters of the pass. The sums are added up in the order in which
// candidate_accumulate adds up the colour's: a layer that equals the colour has equal sums, to the bit.
//
// An invocation filters PIXELS pixels in a row and goes through the offsets row by row, as candidate_accumulate does.
#import stein::nlm::{NlmParams}
#import stein::candidates::{SUM_PLANES}

const PLANES: i32 = #{PLANES};
const PIXELS: i32 = #{PIXELS};

struct PayloadParams {
    // Places of the filters among the candidates. x: small patches, y: large patches, z: features alone.
    places: vec4<i32>,
}

@group(0) @binding(0) var<uniform> params: NlmParams;
@group(0) @binding(1) var<uniform> payload_params: PayloadParams;
// Behind the running sums of the colour, for each pair of neighbours q1 = p + o and q2 = p − o: w(p, q1) and w(p, q2)
// with small patches in x and y, with large patches in z and w. In a pass of all three filters, the weights by the
// features alone follow in x and y of further values; without patches they stand in the first.
@group(0) @binding(2) var<storage, read> state: array<vec4<f32>>;
// PLANES planes.
@group(0) @binding(3) var<storage, read> payload: array<vec4<f32>>;
// Image that holds the neighbours q: the payload again, or the payload of a frame beside.
@group(0) @binding(4) var<storage, read> neighbours: array<vec4<f32>>;
// PLANES planes for each candidate.
@group(0) @binding(5) var<storage, read_write> sums: array<vec4<f32>>;
#ifdef ENDS_OWN_FRAME
// Gets the sums over the own frame, which this chunk completes.
@group(0) @binding(6) var<storage, read_write> sums_alone: array<vec4<f32>>;
#endif

// Read once: software adapters read a parameter anew wherever it is used.
var<private> nlm: NlmParams;

alias Planes = array<vec4<f32>, PLANES>;

// Loads the pixel in this row nearest to column x.
fn neighbour_at(x: i32, row: i32) -> Planes {
    let at = row * nlm.extent.x + clamp(x, 0, nlm.extent.x - 1);
    var planes: Planes;
    for (var plane = 0; plane < PLANES; plane++) {
        planes[plane] = neighbours[plane * nlm.extent.x * nlm.extent.y + at];
    }
    return planes;
}

fn load_sums(place: i32, at: i32) -> Planes {
    var planes: Planes;
    for (var plane = 0; plane < PLANES; plane++) {
        planes[plane] = sums[(place * PLANES + plane) * nlm.extent.x * nlm.extent.y + at];
    }
    return planes;
}

fn store_sums(planes: Planes, place: i32, at: i32) {
    for (var plane = 0; plane < PLANES; plane++) {
        let at_plane = (place * PLANES + plane) * nlm.extent.x * nlm.extent.y + at;
        sums[at_plane] = planes[plane];
#ifdef ENDS_OWN_FRAME
        sums_alone[at_plane] = planes[plane];
#endif
    }
}

@compute @workgroup_size(32, 2, 1)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    nlm = params;
    let places = payload_params.places;
    let extent = nlm.extent;
    let row = i32(id.y);
    let y = nlm.first_row + row;
    let first_column = i32(id.x) * PIXELS;
    let first_x = nlm.first_column + first_column;
    if first_column >= nlm.width || row >= nlm.rows {
        return;
    }
    let pixels = extent.x * extent.y;
    var centres: array<Planes, PIXELS>;
    var smalls: array<Planes, PIXELS>;
    var larges: array<Planes, PIXELS>;
    var alones: array<Planes, PIXELS>;
    for (var i = 0; i < PIXELS; i++) {
        let at_p = y * extent.x + min(first_x + i, extent.x - 1);
        for (var plane = 0; plane < PLANES; plane++) {
            centres[i][plane] = payload[plane * pixels + at_p];
        }
        if nlm.starts == 0 {
#ifdef SMALL
            smalls[i] = load_sums(places.x, at_p);
#endif
#ifdef LARGE
            larges[i] = load_sums(places.y, at_p);
#endif
#ifdef FEATURES_ALONE
            alones[i] = load_sums(places.z, at_p);
#endif
        }
    }

    let pair_values = nlm.offsets.x * nlm.offsets.y * nlm.rows * nlm.stride;
    for (var j = 0; j < nlm.offsets.y; j++) {
        let dy = nlm.first_offset.y + j;
        let ahead_row = min(y + dy, extent.y - 1);
        let behind_row = max(y - dy, 0);

        // The neighbours that the first offset shares with the offset before it.
        var aheads: array<Planes, PIXELS>;
        var behinds: array<Planes, PIXELS>;
        for (var i = 0; i < PIXELS - 1; i++) {
            aheads[i + 1] = neighbour_at(first_x + i + nlm.first_offset.x, ahead_row);
            behinds[i] = neighbour_at(first_x + i + 1 - nlm.first_offset.x, behind_row);
        }
        for (var o = 0; o < nlm.offsets.x; o++) {
            let dx = nlm.first_offset.x + o;
            for (var i = 0; i < PIXELS - 1; i++) {
                aheads[i] = aheads[i + 1];
                behinds[PIXELS - 1 - i] = behinds[PIXELS - 2 - i];
            }
            aheads[PIXELS - 1] = neighbour_at(first_x + PIXELS - 1 + dx, ahead_row);
            behinds[0] = neighbour_at(first_x - dx, behind_row);

            let at_weights = SUM_PLANES * nlm.rows * nlm.width
                + ((j * nlm.offsets.x + o) * nlm.rows + row) * nlm.stride + first_column;
            for (var i = 0; i < PIXELS; i++) {
#ifdef LARGE
                let by_color = state[at_weights + i];
#ifdef FEATURES_ALONE
                let by_features = state[at_weights + pair_values + i];
#endif
#else
                let by_features = state[at_weights + i];
#endif
                for (var plane = 0; plane < PLANES; plane++) {
                    let ahead = aheads[i][plane] - centres[i][plane];
                    let behind = behinds[i][plane] - centres[i][plane];
#ifdef SMALL
                    smalls[i][plane] = (smalls[i][plane] + by_color.x * ahead) + by_color.y * behind;
#endif
#ifdef LARGE
                    larges[i][plane] = (larges[i][plane] + by_color.z * ahead) + by_color.w * behind;
#endif
#ifdef FEATURES_ALONE
                    alones[i][plane] += by_features.x * ahead + by_features.y * behind;
#endif
                }
            }
        }
    }

    for (var i = 0; i < PIXELS; i++) {
        if first_column + i < nlm.width {
            let at_p = y * extent.x + first_x + i;
#ifdef SMALL
            store_sums(smalls[i], places.x, at_p);
#endif
#ifdef LARGE
            store_sums(larges[i], places.y, at_p);
#endif
#ifdef FEATURES_ALONE
            store_sums(alones[i], places.z, at_p);
#endif
        }
    }
}
