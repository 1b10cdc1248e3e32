// Turns the values of one layer, or of two that are compared, into colours. A triangle covers the view, and each
// invocation looks up the pixels of the image that its pixel of the screen shows.

// The overrides fix what a draw does when its pipeline is built: on a processor, a branch that is not taken costs as
// much as a branch that is taken.

// Values of layer A: 0 colour, 1 direction, 2 numbers, 3 shares.
override KIND: u32;
// 0 layer A alone, 1 A − B, 2 (A − B)/(|B| + epsilon).
override OPERATION: u32;
// 0 sRGB, 1 gamma, 2 Reinhard, 3 filmic.
override TONE: u32;
// Whether the false-colour scale is logarithmic.
override IS_LOG: bool;
// Whether a pixel of the screen covers several pixels of the image.
override REDUCES: bool;
// Whether the target encodes sRGB by itself.
override ENCODES: bool;

struct Draw {
    // Position in the image of the fragment at (x, y): first + (x, y) · step, in pixels of the image.
    first: vec2f,
    step: vec2f,
    // Width and height of the image in pixels.
    size: vec2u,
    // Number of planes of layer A and B.
    planes_a: u32,
    planes_b: u32,
    // 0 all channels, 1 to 3 a single channel.
    channel: u32,
    // Row of the colour table.
    colormap: u32,
    // Number of taps along each axis if the image is reduced.
    taps: u32,
    epsilon: f32,
    factor: f32,
    offset: f32,
    inverse_gamma: f32,
    // Ends of the false-colour scale.
    low: f32,
    high: f32,
    background: vec4f,
}

@group(0) @binding(0) var<uniform> draw: Draw;
@group(0) @binding(1) var colors: texture_2d<f32>;
@group(1) @binding(0) var layer_a: texture_2d<f32>;
@group(1) @binding(1) var layer_b: texture_2d<f32>;

@vertex
fn cover(@builtin(vertex_index) index: u32) -> @builtin(position) vec4f {
    let corner = vec2f(f32(index & 1u), f32(index >> 1u));
    return vec4f(corner * 4.0 - 1.0, 0.0, 1.0);
}

// Tests the bits, because compilers take x != x for false.
fn is_finite(value: f32) -> bool {
    return (bitcast<u32>(value) & 0x7f800000u) != 0x7f800000u;
}

fn all_finite(value: vec3f) -> bool {
    return is_finite(value.x) && is_finite(value.y) && is_finite(value.z);
}

// Returns the mean over the pixels of the image that a pixel of the screen covers.
fn fetch(layer: texture_2d<f32>, place: vec2f) -> vec3f {
    let last = vec2i(draw.size) - 1;
    if !REDUCES {
        return textureLoad(layer, clamp(vec2i(floor(place)), vec2i(0), last), 0).xyz;
    }
    var sum = vec3f(0.0);
    for (var y = 0u; y < draw.taps; y++) {
        for (var x = 0u; x < draw.taps; x++) {
            let tap = place + ((vec2f(f32(x), f32(y)) + 0.5) / f32(draw.taps) - 0.5) * draw.step;
            sum += textureLoad(layer, clamp(vec2i(floor(tap)), vec2i(0), last), 0).xyz;
        }
    }
    return sum / f32(draw.taps * draw.taps);
}

// Returns one number for all channels: their mean, or the chosen channel.
fn number(value: vec3f, planes: u32) -> f32 {
    if draw.channel > 0u && draw.channel <= planes {
        return value[draw.channel - 1u];
    }
    if planes == 1u {
        return value.x;
    }
    if planes == 2u {
        return (value.x + value.y) / 2.0;
    }
    return (value.x + value.y + value.z) / 3.0;
}

fn srgb(value: vec3f) -> vec3f {
    let clamped = clamp(value, vec3f(0.0), vec3f(1.0));
    return select(1.055 * pow(clamped, vec3f(1.0 / 2.4)) - 0.055, 12.92 * clamped, clamped <= vec3f(0.0031308));
}

fn tone_mapped(value: vec3f) -> vec3f {
    let positive = max(value, vec3f(0.0));
    switch TONE {
        case 1u: { return pow(min(positive, vec3f(1.0)), vec3f(draw.inverse_gamma)); }
        case 2u: { return srgb(positive / (1.0 + positive)); }
        case 3u: {
            // Large values would overflow. They are white long before that.
            let x = min(positive, vec3f(1e4));
            return srgb(x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14));
        }
        default: { return srgb(positive); }
    }
}

fn false_color(value: f32) -> vec3f {
    var place = (value - draw.low) / (draw.high - draw.low);
    if IS_LOG {
        place = 0.0;
        if value > 0.0 {
            place = log2(value / draw.low) / log2(draw.high / draw.low);
        }
    }
    let step = clamp(place, 0.0, 1.0) * f32(textureDimensions(colors).x - 1u);
    let before = u32(floor(step));
    let after = min(before + 1u, textureDimensions(colors).x - 1u);
    return mix(textureLoad(colors, vec2u(before, draw.colormap), 0).xyz,
        textureLoad(colors, vec2u(after, draw.colormap), 0).xyz, fract(step));
}

// Returns a chequered pattern for values that are NaN or infinite, which no colour of a layer looks like.
fn chequered(position: vec2f) -> vec3f {
    let cell = vec2u(position) / 4u;
    return select(vec3f(0.0), vec3f(1.0, 0.0, 1.0), ((cell.x + cell.y) & 1u) == 0u);
}

fn shown(a: vec3f, b: vec3f, position: vec2f) -> vec3f {
    if OPERATION != 0u {
        if !all_finite(a) || !all_finite(b) {
            return chequered(position);
        }
        let of_b = number(b, draw.planes_b);
        let difference = number(a, draw.planes_a) - of_b;
        return false_color(select(difference, difference / (abs(of_b) + draw.epsilon), OPERATION == 2u));
    }
    if !all_finite(a) {
        return chequered(position);
    }
    switch KIND {
        case 1u: {
            if draw.channel > 0u {
                return vec3f(clamp(number(a, 3u) * 0.5 + 0.5, 0.0, 1.0));
            }
            return clamp(a * 0.5 + 0.5, vec3f(0.0), vec3f(1.0));
        }
        case 2u: { return false_color(number(a, draw.planes_a)); }
        case 3u: {
            if draw.channel > 0u {
                return vec3f(clamp(number(a, 3u), 0.0, 1.0));
            }
            return clamp(a, vec3f(0.0), vec3f(1.0));
        }
        default: {
            if draw.channel > 0u {
                return tone_mapped(vec3f(number(a, draw.planes_a)) * draw.factor + draw.offset);
            }
            return tone_mapped(a * draw.factor + draw.offset);
        }
    }
}

@fragment
fn paint(@builtin(position) position: vec4f) -> @location(0) vec4f {
    let place = draw.first + position.xy * draw.step;
    var color = draw.background.xyz;
    if all(place >= vec2f(0.0)) && all(place < vec2f(draw.size)) {
        let a = fetch(layer_a, place);
        var b = a;
        if OPERATION != 0u {
            b = fetch(layer_b, place);
        }
        color = shown(a, b, position.xy);
    }
    if ENCODES {
        color = select(pow((color + 0.055) / 1.055, vec3f(2.4)), color / 12.92, color <= vec3f(0.04045));
    }
    return vec4f(color, 1.0);
}
