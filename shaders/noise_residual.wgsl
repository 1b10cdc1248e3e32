// Estimates noise as the difference of a pixel from its neighbours along x or along y, whichever is less: an edge
// stands out along only one of them.
//
// Texture stands out, too. A least-squares fit over the pixels around explains it by the differences of the features.
// But noisy features, as in parts out of focus, would explain noise away. So the residual of the fit counts less than
// the difference without a fit.
#import stein::planes::{pixel_index}

// Number of features, of three channels each.
const REGRESSORS: i32 = #{REGRESSORS};

struct NoiseResidualParams {
    extent: vec2<i32>,
    // Radius of the window of a fit.
    fit_radius: i32,
    // Ridge: added to the diagonal of a fit, in parts of the sum of its weights.
    ridge: f32,
    // Weight of the residual of the fit in the geometric mean.
    fitted_share: f32,
    // The largest noise of a pixel that is no brighter than its neighbours, in magnitudes.
    largest: f32,
    // Factor that brings the lesser of two residuals to the size of a half spread.
    scale: f32,
}

@group(0) @binding(0) var<uniform> params: NoiseResidualParams;
@group(0) @binding(1) var<storage, read> signal: array<vec4<f32>>;
// Output of noise_highpass.
@group(0) @binding(2) var<storage, read> highpass: array<vec4<f32>>;
// Two planes: the mean, then the estimated noise instead of the half spread.
@group(0) @binding(3) var<storage, read_write> residual: array<vec4<f32>>;
// Output of noise_magnitude, changed in place: the half spread becomes the estimated noise.
@group(0) @binding(4) var<storage, read_write> relative_spread: array<vec4<f32>>;

// The lesser of the differences along both axes; in an image of one row or column, the difference along its one axis.
fn lesser(along_x: vec3<f32>, along_y: vec3<f32>) -> vec3<f32> {
    let x = select(abs(along_x), vec3<f32>(3.4e38), params.extent.x == 1);
    let y = select(abs(along_y), vec3<f32>(3.4e38), params.extent.y == 1);
    return select(min(x, y), vec3<f32>(0.0), all(params.extent == vec2<i32>(1)));
}

#if REGRESSORS != 0
const TERMS: i32 = 3 * REGRESSORS;

struct Fit {
    // Coefficients of each term, one for each of the three channels.
    coefficients: array<vec3<f32>, TERMS>,
}

fn term(at: i32, axis: i32, index: i32) -> f32 {
    let pixels = params.extent.x * params.extent.y;
    return highpass[(2 + 2 * (index / 3) + axis) * pixels + at][index % 3];
}

// The normal equations over the window, of both axes in one, solved by Cholesky's decomposition.
fn fit_around(p: vec2<i32>) -> Fit {
    let pixels = params.extent.x * params.extent.y;
    let first = max(p - params.fit_radius, vec2<i32>(0));
    let last = min(p + params.fit_radius, params.extent - 1);
    // The lower triangle, row by row.
    var matrix: array<f32, (TERMS * (TERMS + 1)) / 2>;
    var fit: Fit;
    var weight_sum = 0.0;
    for (var y = first.y; y <= last.y; y++) {
        for (var x = first.x; x <= last.x; x++) {
            let at = pixel_index(vec2<i32>(x, y), params.extent);
            for (var axis = 0; axis < 2; axis++) {
                let color = highpass[axis * pixels + at];
                let w = 1.0 / (color.w * color.w);
                var terms: array<f32, TERMS>;
                for (var index = 0; index < TERMS; index++) {
                    terms[index] = term(at, axis, index);
                }
                var place = 0;
                for (var row = 0; row < TERMS; row++) {
                    let weighted = w * terms[row];
                    for (var column = 0; column <= row; column++) {
                        matrix[place] += weighted * terms[column];
                        place++;
                    }
                    fit.coefficients[row] += weighted * color.xyz;
                }
                weight_sum += 0.5 * w;
            }
        }
    }
    for (var row = 0; row < TERMS; row++) {
        let row_start = (row * (row + 1)) / 2;
        matrix[row_start + row] += params.ridge * weight_sum;
        for (var column = 0; column <= row; column++) {
            let column_start = (column * (column + 1)) / 2;
            var sum = matrix[row_start + column];
            for (var before = 0; before < column; before++) {
                sum -= matrix[row_start + before] * matrix[column_start + before];
            }
            // The limit keeps the ridge when the sum suffers from round-off.
            let diagonal = sqrt(max(sum, 0.5 * params.ridge * weight_sum));
            matrix[row_start + column] = select(sum / matrix[column_start + column], diagonal, row == column);
        }
        var value = fit.coefficients[row];
        for (var before = 0; before < row; before++) {
            value -= matrix[row_start + before] * fit.coefficients[before];
        }
        fit.coefficients[row] = value / matrix[row_start + row];
    }
    for (var row = TERMS - 1; row >= 0; row--) {
        var value = fit.coefficients[row];
        for (var after = row + 1; after < TERMS; after++) {
            value -= matrix[(after * (after + 1)) / 2 + row] * fit.coefficients[after];
        }
        fit.coefficients[row] = value / matrix[(row * (row + 1)) / 2 + row];
    }
    return fit;
}
#endif

@compute @workgroup_size(32, 2, 1)
fn main(@builtin(global_invocation_id) id: vec3<u32>) {
    let p = vec2<i32>(id.xy);
    if any(p >= params.extent) {
        return;
    }
    let pixels = params.extent.x * params.extent.y;
    let at = pixel_index(p, params.extent);
    let along_x = highpass[at];
    let along_y = highpass[pixels + at];
    var noise = lesser(along_x.xyz, along_y.xyz);
#if REGRESSORS != 0
    let fit = fit_around(p);
    var explained = array<vec3<f32>, 2>(vec3<f32>(0.0), vec3<f32>(0.0));
    for (var index = 0; index < TERMS; index++) {
        for (var axis = 0; axis < 2; axis++) {
            explained[axis] += term(at, axis, index) * fit.coefficients[index];
        }
    }
    let left = lesser(along_x.xyz - explained[0], along_y.xyz - explained[1]);
    noise = pow(left, vec3<f32>(params.fitted_share)) * pow(noise, vec3<f32>(1.0 - params.fitted_share));
#endif
    noise *= params.scale;
    let stands_out = (along_x.xyz > vec3<f32>(0.0)) & (along_y.xyz > vec3<f32>(0.0));
    noise = select(min(noise, vec3<f32>(params.largest * along_x.w)), noise, stands_out);
    residual[at] = signal[at];
    residual[pixels + at] = vec4<f32>(noise, 0.0);
    let magnitude = along_x.w;
    relative_spread[at] = vec4<f32>(noise / magnitude, magnitude);
}
