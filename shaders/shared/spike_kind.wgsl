// Test whether two pixels are of one kind by their features, with its bindings: parameters and features.
#define_import_path stein::spike_kind
#import stein::spike::{SpikeParams, SpikeFeatures, are_alike}

const FEATURE_GROUPS: i32 = #{FEATURE_GROUPS};

@group(0) @binding(0) var<uniform> params: SpikeParams;
#if FEATURE_GROUPS != 0
// Three planes per group: value, residual variance, the larger of residual variance and squared gradient.
@group(0) @binding(2) var<storage, read> features: array<vec4<f32>>;
#endif

#if FEATURE_GROUPS != 0
fn features_at(at: i32, group: i32) -> SpikeFeatures {
    let pixels = params.extent.x * params.extent.y;
    let plane = 3 * group * pixels + at;
    return SpikeFeatures(features[plane], features[plane + pixels], features[plane + 2 * pixels]);
}
#endif

// Whether the pixel at q is of the kind of the pixel at p. Without features, all pixels are of one kind.
fn is_like(at_p: i32, at_q: i32) -> bool {
    var alike = true;
#if FEATURE_GROUPS != 0
    for (var group = 0; group < FEATURE_GROUPS && alike; group++) {
        alike = are_alike(features_at(at_p, group), features_at(at_q, group), params.triple_weights[group].xyz, params);
    }
#endif
    return alike;
}
