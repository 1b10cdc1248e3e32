//! List of the shader files. A listed file that is missing fails the build; a file that is not listed fails a test.

/// Embeds `<folder>/<name>.wgsl` for every name: pairs of name and source.
macro_rules! sources {
    ($folder:literal: $($name:literal),* $(,)?) => {
        &[$(($name, include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/", $folder, "/", $name, ".wgsl")))),*]
    };
}

/// Pieces that stages import (`#define_import_path stein::...`), in any order.
#[rustfmt::skip]
pub(super) const SHARED: &[(&str, &str)] = sources!("shaders/shared":
    "planes",
    "nlm",
    "candidates",
    "exact",
    "noise",
    "spike",
    "spike_kind",
    "window",
);

/// The stages: each file is one kernel.
#[rustfmt::skip]
pub(super) const STAGES: &[(&str, &str)] = sources!("shaders":
    "noise_magnitude",
    "noise_guess",
    "noise_feature",
    "noise_pool",
    "noise_unpack",
    "noise_highpass",
    "noise_residual",
    "noise_jump",
    "noise_hold",
    "spike_find",
    "spike_level",
    "spike_share",
    "spike_rows",
    "spike_spread",
    "light_return",
    "variance_rows",
    "variance_scale",
    "variance_smooth",
    "variance_pair",
    "variance_clamp",
    "variance_floor",
    "half_split",
    "half_join",
    "gaussian",
    "nlm_distance",
    "nlm_weight",
    "nlm_filter",
    "nlm_window",
    "feature_pack",
    "candidate_accumulate",
    "candidate_resolve",
    "candidate_window",
    "error_sure",
    "error_difference",
    "error_blend",
    "error_spikes",
    "error_halves",
    "select_least",
    "select_share",
    "select_blend",
    "select_frames",
    "select_color_only",
    "select_pass",
    "keep_clean",
    "exact_copy",
    "exact_fill",
    "sample_attach",
    "sample_density",
    "scale_pixel",
    "scale_stop",
    "scale_advance",
    "scale_reduction",
    "payload_level",
    "payload_spread",
    "payload_accumulate",
    "payload_blend",
    "payload_mix",
    "payload_scale",
    "payload_half",
);
