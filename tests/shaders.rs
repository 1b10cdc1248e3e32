//! Every stage, with every set of definitions in use, is valid WGSL and can be translated for every backend. Needs no
//! adapter.
#![expect(clippy::unwrap_used, reason = "a test that cannot go on says where")]

use naga::ShaderStage;
use naga::back::{glsl, hlsl, msl, spv};
use naga::proc::BoundsCheckPolicies;
use naga::valid::{Capabilities, ModuleInfo, ValidationFlags, Validator};
use stein::gpu::{Definition, compose, shared_modules, stages};

type Definitions = Vec<(&'static str, Definition)>;

const BOTH: [bool; 2] = [false, true];

/// All combinations of the values of each name.
fn combinations(axes: &[(&'static str, Vec<Definition>)]) -> Vec<Definitions> {
    axes.iter().fold(vec![Vec::new()], |sets, (name, values)| {
        let extended = |set: Definitions| {
            values.iter().map(move |value| [set.as_slice(), &[(*name, *value)]].concat()).collect::<Vec<_>>()
        };
        sets.into_iter().flat_map(extended).collect()
    })
}

fn flags() -> Vec<Definition> {
    BOTH.map(Definition::from).to_vec()
}

fn numbers(values: &[i32]) -> Vec<Definition> {
    values.iter().map(|value| Definition::from(*value)).collect()
}

/// Numbers of candidates: one, the thesis's three, one more than a plane of numbers holds, all there may be.
fn candidates() -> (&'static str, Vec<Definition>) {
    ("CANDIDATES", numbers(&[1, 3, 5, 8]))
}

/// Numbers of planes in a group of a payload.
fn planes() -> (&'static str, Vec<Definition>) {
    ("PLANES", numbers(&[1, 2, 3, 4]))
}

/// Filters of a pass over the window that take part.
fn takes_part() -> Vec<(&'static str, Vec<Definition>)> {
    ["SMALL", "LARGE", "FEATURES_ALONE"].map(|name| (name, flags())).to_vec()
}

fn is_on(set: &Definitions, name: &str) -> bool {
    set.contains(&(name, true.into()))
}

/// The definitions with what follows from the filters; `None` where no pass has these filters.
fn as_a_pass(set: Definitions) -> Option<Definitions> {
    let is_pass =
        (is_on(&set, "LARGE") || is_on(&set, "FEATURES_ALONE")) && (is_on(&set, "LARGE") || !is_on(&set, "SMALL"));
    let color = [("COLOR", is_on(&set, "LARGE").into())];
    is_pass.then(|| [&set[..], &color].concat())
}

/// Treatment of opposite neighbours: none, by degrees, at once.
fn with_rules(sets: &[Definitions]) -> Vec<Definitions> {
    let rules = [(false, false), (true, false), (true, true)]
        .map(|(symmetric, hard)| [("SYMMETRIC", symmetric.into()), ("SYMMETRIC_HARD", hard.into())]);
    sets.iter().flat_map(|set| rules.iter().map(|rule| [set.as_slice(), rule].concat())).collect()
}

/// Definitions that the functions of `stein::stage` use: patches of 0 to 5 pixels (1 and 3 in the presets), small
/// patches beside large ones or none, packed features in up to eight groups. Every stage must be listed here.
fn definitions(stage: &str) -> Option<Vec<Definitions>> {
    let none = Some(vec![Vec::new()]);
    match stage {
        "variance_rows" => Some(combinations(&[("PIXELS", numbers(&[4])), ("BY_DEVIATION", flags())])),
        "variance_scale" => Some(combinations(&[("PIXELS", numbers(&[4]))])),
        "noise_magnitude" | "noise_unpack" | "noise_jump" | "noise_hold" => none,
        "noise_highpass" | "noise_residual" => Some(combinations(&[("REGRESSORS", numbers(&[0, 1, 2]))])),
        "noise_guess" => Some(combinations(&[("PIXELS", numbers(&[4]))])),
        "noise_feature" => Some(combinations(&[("PIXELS", numbers(&[4])), ("VARIANCE", flags())])),
        "noise_pool" => {
            let featureless =
                combinations(&[("FEATURE_GROUPS", numbers(&[0])), ("PIXELS", numbers(&[4])), ("VARIANCE", flags())]);
            let few = combinations(&[
                ("FEATURE_GROUPS", numbers(&[1, 2])),
                ("PIXELS", numbers(&[4])),
                ("FEATURE_NOISE", flags()),
                ("VARIANCE", flags()),
            ]);
            let many = combinations(&[
                ("FEATURE_GROUPS", numbers(&[8])),
                ("PIXELS", numbers(&[1])),
                ("FEATURE_NOISE", flags()),
                ("VARIANCE", flags()),
            ]);
            Some([featureless, few, many].concat())
        }
        "spike_find" => Some(combinations(&[("FEATURE_GROUPS", numbers(&[0, 1, 2, 8])), ("VARIANCE", flags())])),
        "spike_share" => Some(combinations(&[("FEATURE_GROUPS", numbers(&[0, 1, 2, 8]))])),
        "spike_level" | "spike_rows" | "error_spikes" => none,
        "spike_spread" => Some(combinations(&[("FEATURE_GROUPS", numbers(&[0, 1, 2, 8]))])),
        "light_return" => Some(combinations(&[("ERROR", flags())])),
        "keep_clean" => Some(combinations(&[("VARIANCE", flags()), ("ERROR", flags())])),
        "variance_pair" | "variance_clamp" | "variance_floor" | "half_split" | "half_join" => none,
        "select_pass" | "select_color_only" => none,
        "candidate_resolve" => {
            Some(combinations(&[("FEATURES_ALONE", flags()), ("DERIVATIVES", flags()), ("OTHER_GUIDE", flags())]))
        }
        "feature_pack" => Some(combinations(&[("NOISY", flags())])),
        "error_sure" | "error_difference" => Some(combinations(&[candidates()])),
        "select_blend" => Some(combinations(&[candidates(), ("SHARED", flags())])),
        "select_least" => Some(combinations(&[candidates(), ("RIVALS", flags())])),
        "select_share" => Some(combinations(&[candidates(), ("GUARDED", flags())])),
        "exact_copy" => Some(combinations(&[("WEIGHT_SUM", flags())])),
        "exact_fill" => Some(combinations(&[("ONES", flags())])),
        "select_frames" => Some(
            [
                combinations(&[candidates()]),
                combinations(&[("CANDIDATES", numbers(&[1])), ("WEIGHT_SUMS", vec![true.into()])]),
            ]
            .concat(),
        ),
        "sample_attach" => Some(combinations(&[("SAMPLES_VARY", flags())])),
        "error_blend" => Some(combinations(&[candidates(), ("SHARED", flags()), ("ADDED", flags())])),
        "error_halves" => Some(combinations(&[("HALVES", flags())])),
        "scale_stop" | "scale_reduction" => none,
        "scale_pixel" => Some(combinations(&[("SAMPLES_VARY", flags())])),
        "scale_advance" => Some(combinations(&[("COARSER_ONLY", flags())])),
        "sample_density" => Some(combinations(&[("SAMPLES_VARY", flags()), ("HALVES", flags())])),
        "gaussian" => Some(
            ["SQUARED", "KEEP_WEIGHT_SUM", "WITHOUT_CENTRE"]
                .map(|name| vec![(name, true.into())])
                .into_iter()
                .chain([Vec::new()])
                .collect(),
        ),
        "variance_smooth" => Some(combinations(&[("CLAMPED", flags())])),
        "nlm_distance" => {
            let shapes = [([0, 1, 3, 5].as_slice(), [-1, 0].as_slice()), (&[1, 3, 5], &[1])];
            let set = |(patches, small): (&[i32], &[i32])| {
                combinations(&[
                    ("PATCH_RADIUS", numbers(patches)),
                    ("SMALL_PATCH_RADIUS", numbers(small)),
                    ("OFFSET_ROWS", numbers(&[1, 2])),
                    ("SYMMETRIC", flags()),
                ])
            };
            let channels = ["ONE_CHANNEL", "GREY"].map(|name| {
                vec![
                    ("PATCH_RADIUS", 3.into()),
                    ("SMALL_PATCH_RADIUS", 1.into()),
                    ("OFFSET_ROWS", 2.into()),
                    (name, true.into()),
                ]
            });
            Some(shapes.into_iter().flat_map(set).chain(channels).collect())
        }
        "nlm_weight" => {
            Some(with_rules(&combinations(&[("PATCH_RADIUS", numbers(&[0, 1, 3, 5])), ("PIXELS", numbers(&[1, 4]))])))
        }
        "nlm_filter" => {
            let shapes = combinations(&[
                ("PATCH_RADIUS", numbers(&[0, 1, 3, 5])),
                ("PAYLOAD_PLANES", numbers(&[1, 2, 4])),
                ("PIXELS", numbers(&[1, 4])),
                ("PATCHWISE", flags()),
                ("RESIDUAL", flags()),
            ]);
            let narrow = combinations(&[
                ("PATCH_RADIUS", numbers(&[3])),
                ("PAYLOAD_PLANES", numbers(&[1, 2])),
                ("PIXELS", numbers(&[1, 4])),
                ("RESIDUAL", flags()),
                ("ONE_LANE", vec![true.into()]),
                ("GREY", flags()),
            ]);
            Some(with_rules(&[shapes, narrow].concat()))
        }
        "payload_accumulate" => {
            let sets = combinations(
                &[&[planes(), ("PIXELS", numbers(&[1, 4])), ("ENDS_OWN_FRAME", flags())], &takes_part()[..]].concat(),
            );
            Some(sets.into_iter().filter_map(as_a_pass).collect())
        }
        "payload_blend" => Some(combinations(&[candidates(), planes(), ("SHARED", flags()), ("FRAMES", flags())])),
        "payload_mix" => Some(combinations(&[("SHARED", flags())])),
        "payload_level" => {
            Some(combinations(&[("FEATURE_GROUPS", numbers(&[0, 1, 2, 8])), planes(), ("SPREAD", flags())]))
        }
        "payload_spread" => Some(combinations(&[("FEATURE_GROUPS", numbers(&[0, 1, 2, 8])), planes()])),
        "payload_scale" | "payload_half" => none,
        "nlm_window" => {
            Some(with_rules(&combinations(&[("PATCH_RADIUS", numbers(&[0, 1, 3, 5])), ("PATCHWISE", flags())])))
        }
        "candidate_window" => {
            let radii = [
                ("PATCH_RADIUS", numbers(&[1, 3])),
                ("SMALL_PATCH_RADIUS", numbers(&[0, 1])),
                ("FEATURE_GROUPS", numbers(&[0, 1, 2, 8])),
            ];
            let sets = combinations(&[&radii[..], &takes_part(), &[("SYMMETRIC", flags())]].concat());
            Some(sets.into_iter().filter_map(as_a_pass).collect())
        }
        "candidate_accumulate" => {
            let set = |(other_frame, near): (bool, bool)| {
                combinations(&[
                    ("PATCH_RADIUS", numbers(&[1, 3])),
                    ("SMALL_PATCH_RADIUS", numbers(&[0, 1])),
                    ("FEATURE_GROUPS", numbers(&[0, 1, 2, 8])),
                    ("PIXELS", numbers(&[1, 4])),
                    ("OTHER_FRAME", vec![other_frame.into()]),
                    ("NEAR", vec![near.into()]),
                ])
            };
            let whole = |set: Definitions| {
                let parts = ["SMALL", "LARGE", "FEATURES_ALONE", "COLOR", "DERIVATIVES", "HALVES"]
                    .map(|name| (name, true.into()));
                [set.as_slice(), &parts].concat()
            };
            let all = [(false, false), (false, true), (true, false)]
                .into_iter()
                .flat_map(|frames| with_rules(&set(frames)))
                .map(whole);
            // Parts that may be left out.
            let shape = [
                ("PATCH_RADIUS", 3.into()),
                ("SMALL_PATCH_RADIUS", 1.into()),
                ("FEATURE_GROUPS", 2.into()),
                ("PIXELS", 4.into()),
                ("SYMMETRIC", true.into()),
            ];
            let left = combinations(
                &[
                    &takes_part()[..],
                    &["DERIVATIVES", "HALVES", "GREY", "NEAR", "OTHER_FRAME", "WEIGHTS"].map(|name| (name, flags())),
                ]
                .concat(),
            );
            let part = |set: Definitions| {
                let fits = !(is_on(&set, "NEAR") && is_on(&set, "OTHER_FRAME"));
                as_a_pass(set).filter(|_| fits).map(|set| [&shape[..], &set].concat())
            };
            Some(all.chain(left.into_iter().filter_map(part)).collect())
        }
        _ => None,
    }
}

fn in_every_language(what: &str, module: &naga::Module, info: &ModuleInfo) {
    let entry = ("main".to_owned(), ShaderStage::Compute);

    let pipeline = spv::PipelineOptions { shader_stage: entry.1, entry_point: entry.0.clone() };
    let words = spv::write_vec(module, info, &spv::Options::default(), Some(&pipeline))
        .unwrap_or_else(|error| panic!("{what}: SPIR-V: {error}"));
    assert_eq!(words.first(), Some(&0x0723_0203), "{what}: SPIR-V without its magic number");

    let pipeline =
        msl::PipelineOptions { entry_point: Some((entry.1, entry.0.clone())), ..msl::PipelineOptions::default() };
    let options = msl::Options { lang_version: (2, 0), ..msl::Options::default() };
    let (text, _) =
        msl::write_string(module, info, &options, &pipeline).unwrap_or_else(|error| panic!("{what}: MSL: {error}"));
    assert!(text.contains("kernel void"), "{what}: MSL without a kernel");

    let pipeline = hlsl::PipelineOptions { entry_point: Some((entry.1, entry.0.clone())) };
    let (options, mut text) = (hlsl::Options::default(), String::new());
    hlsl::Writer::new(&mut text, &options, &pipeline)
        .write(module, info, None)
        .unwrap_or_else(|error| panic!("{what}: HLSL: {error}"));
    assert!(text.contains("numthreads"), "{what}: HLSL without a kernel");

    let pipeline = glsl::PipelineOptions { shader_stage: entry.1, entry_point: entry.0, multiview: None };
    let (options, mut text) =
        (glsl::Options { version: glsl::Version::Desktop(430), ..glsl::Options::default() }, String::new());
    let written = glsl::Writer::new(&mut text, module, info, &options, &pipeline, BoundsCheckPolicies::default())
        .and_then(|mut writer| writer.write());
    written.unwrap_or_else(|error| panic!("{what}: GLSL: {error}"));
    assert!(text.contains("local_size_x"), "{what}: GLSL without a kernel");
}

fn spirv(stage: &str, set: &Definitions) -> Vec<u32> {
    let module = compose(stage, set).unwrap_or_else(|error| panic!("{stage}: {error}"));
    let info = Validator::new(ValidationFlags::all(), Capabilities::empty()).validate(&module).unwrap();
    spv::write_vec(&module, &info, &spv::Options::default(), None).unwrap()
}

/// Number of storage buffers per shader on every WebGPU device.
const STORAGE_BUFFERS_EVERYWHERE: usize = 8;

/// Number of workgroups per axis of a dispatch on every WebGPU device.
const WORKGROUPS_EVERYWHERE: u32 = 65_535;

/// Images are cut into strips of rows, but not of columns; files of wider images are refused.
const WIDEST_IMAGE: u32 = 1 << 20;

fn fits_the_least_of_devices(stage: &str, set: &Definitions, module: &naga::Module) {
    let buffers = module
        .global_variables
        .iter()
        .filter(|(_, variable)| matches!(variable.space, naga::AddressSpace::Storage { .. }))
        .count();
    assert!(buffers <= STORAGE_BUFFERS_EVERYWHERE, "{stage} with {set:?} binds {buffers} storage buffers");
    let [columns, ..] = module.entry_points[0].workgroup_size;
    assert!(
        WORKGROUPS_EVERYWHERE * columns >= WIDEST_IMAGE,
        "{stage} with {set:?} does not reach the last column of the widest image in a file"
    );
}

#[test]
fn every_stage_is_valid_translates_and_fits_the_least_of_devices() {
    for stage in stages() {
        let sets = definitions(stage).unwrap_or_else(|| {
            panic!("stage '{stage}' is not in the table of this test: add the definitions it is used with")
        });
        for set in sets {
            let what = format!("{stage} with {set:?}");
            let module = compose(stage, &set).unwrap_or_else(|error| panic!("{what}: {error}"));
            let info = Validator::new(ValidationFlags::all(), Capabilities::empty()).validate(&module);
            let info = info.unwrap_or_else(|error| panic!("{what}: {}", error.into_inner()));
            in_every_language(&what, &module, &info);
            fits_the_least_of_devices(stage, &set, &module);
        }
    }
}

/// Caches find a compiled stage by its source, so a stage must be the same to the byte, whichever stages were composed
/// before it.
#[test]
fn a_stage_is_the_same_whatever_was_composed_before() {
    let all = |stages: &[&'static str]| -> Vec<Vec<u32>> {
        stages.iter().map(|stage| spirv(stage, &definitions(stage).unwrap_or_default()[0])).collect()
    };
    let forwards = stages();
    let backwards: Vec<_> = forwards.iter().rev().copied().collect();
    let mut again = all(&backwards);
    again.reverse();
    assert_eq!(all(&forwards), again);
}

/// Every file in `shaders/` is a stage and every file in `shaders/shared/` a piece that stages import: unused files
/// would only look like part of the program.
#[test]
fn every_file_is_used() {
    let names = |folder: &str| {
        let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join(folder);
        let files = std::fs::read_dir(folder)
            .unwrap()
            .map(|entry| entry.unwrap().path())
            .filter(|path| path.extension().is_some_and(|e| e == "wgsl"));
        let mut names: Vec<String> = files.map(|path| path.file_stem().unwrap().to_str().unwrap().to_owned()).collect();
        names.sort();
        names
    };
    let sorted = |mut listed: Vec<&'static str>| {
        listed.sort_unstable();
        listed
    };
    assert_eq!(names("shaders"), sorted(stages()));
    assert_eq!(names("shaders/shared"), sorted(shared_modules()));
}
