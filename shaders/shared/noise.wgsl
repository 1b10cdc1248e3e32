// Code shared by the stages that estimate a variance where none is given.
#define_import_path stein::noise

struct NoiseParams {
    extent: vec2<i32>,
    // Largest ratio of the brightness around a pixel to its own brightness; a larger ratio is cut to this one.
    darker: f32,
    // The least magnitude.
    least_magnitude: f32,
    // −1 / (2σ²) of the Gaussian of the first guess, σ in pixels, and its radius.
    guess_exponent: f32,
    guess_radius: i32,
    // Radius of the box over which the noise of features is averaged.
    feature_radius: i32,
    // Radius of the window whose pixels are pooled.
    window_radius: i32,
    // Magnitudes that differ by more than this factor are not pooled.
    gate: f32,
    // The distance above which a pixel is not pooled.
    largest_distance: f32,
    // k_f² and τ: how large a difference between features counts.
    squared_feature_k: f32,
    feature_tau: f32,
    // Noise up to which a pixel counts as without noise: its standard deviation in parts of its value.
    least_noise: f32,
    // Weight of the pooled variance, relative to a weight of 1 for the pixel's own variance.
    pooled_share: f32,
    // 1 / number of channels, per channel of the triple.
    triple_weights: array<vec4<f32>, 8>,
}

// Parameters of the stage that looks for jumps of brightness, and of the stage that holds the variance beside them.
struct NoiseHoldParams {
    extent: vec2<i32>,
    // Radius of the box within which brightness must not jump, and the factor from which on it jumps.
    jump_radius: i32,
    jump: f32,
    least_magnitude: f32,
    // Radius of the box by which a pixel near a jump is judged.
    radius: i32,
}

fn brightness(color: vec3<f32>) -> f32 {
    return abs(color.x + color.y + color.z) / 3.0;
}
