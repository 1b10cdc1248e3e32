//! Settings that programs share: options of their command lines, and the folder of compiled pipelines.

use std::ffi::OsString;
use std::path::PathBuf;

use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use stein::error::Remedy;
use stein::gpu::GpuOptions;
use stein::parameters::Choice;

/// Environment variable that names another folder for compiled pipelines; if it is empty, none are kept.
pub const CACHE_VARIABLE: &str = "STEIN_CACHE";

/// Returns the options with which programs open a device. Compiled pipelines are kept in the folder that
/// [`CACHE_VARIABLE`] names, or else in `stein` among the user's caches.
pub fn gpu_options() -> GpuOptions {
    GpuOptions {
        pipeline_folder: pipeline_folder(std::env::var_os(CACHE_VARIABLE), dirs::cache_dir()),
        ..GpuOptions::default()
    }
}

/// Returns a remedy in the words that programs share: those with the options of
/// [`BufferSetRequest`](crate::BufferSetRequest) and `--device`. Other remedies stay in the library's words.
pub fn remedy(remedy: &Remedy) -> String {
    match remedy {
        Remedy::GiveHalves => {
            "render twice with different seeds and give both files (`stein denoise seed1.exr seed2.exr`, or --seed)"
                .into()
        }
        Remedy::GiveVariance => {
            "let the renderer write the variance of the pixel mean, as layer `variance` or for --variance".into()
        }
        Remedy::GiveOtherHalf { half } => {
            format!("add half {half} (for the colour: --half-{})", half.to_ascii_lowercase())
        }
        Remedy::LeaveFeaturesOut => "leave features out (--skip-feature, --no-features)".into(),
        Remedy::SkipFeature => "leave the feature out (--skip-feature)".into(),
        Remedy::NameFeatureToSkip => "name one of these with --skip-feature, or none".into(),
        Remedy::NameLayersAlong => "name other layers with --aovs, or leave it out".into(),
        Remedy::GiveFeatureToo => {
            "give the feature itself, too (--feature), or its name as `stein info` lists it".into()
        }
        Remedy::SayQuantity { quantity } => format!(
            "say so with --layout FILE, a layout with `quantity = \"{quantity}\"` for it (`stein layouts --show NAME` \
             prints one to start from), and with --samples N"
        ),
        Remedy::GiveUnfiltered => "name the layer before any filter (--layer)".into(),
        Remedy::GiveSamples => "say how many samples a pixel has (--samples N)".into(),
        Remedy::NameLayer => "name the layer to take (--layer, or FILE::LAYER)".into(),
        Remedy::AnotherAdapter => "choose another adapter with --device (`stein devices` lists them)".into(),
        Remedy::PipelineFolder => {
            format!("have {CACHE_VARIABLE} name a folder that may be written to, or none")
        }
        // Only a defect of the program brings its user here.
        Remedy::ChangeCall(_) => "report this defect of stein with the whole command".into(),
        remedy => remedy.to_string(),
    }
}

/// Returns the requested folder, or one among the user's other caches. Returns `None` if the request is empty, or if
/// there is no request and the user has no caches.
fn pipeline_folder(asked_for: Option<OsString>, caches: Option<PathBuf>) -> Option<PathBuf> {
    match asked_for {
        Some(folder) => (!folder.is_empty()).then(|| folder.into()),
        None => caches.map(|caches| caches.join("stein")),
    }
}

/// Returns a parser of one of several values. The word of each choice stands for the value at the same index, and the
/// help explains the choices.
pub fn choice<T: Clone + Send + Sync + 'static>(
    values: &[T],
    choices: &[Choice],
) -> impl TypedValueParser<Value = T> + use<T> {
    let by_name: Vec<(&str, T)> = choices.iter().map(|choice| choice.name).zip(values.iter().cloned()).collect();
    let find = move |name: String| {
        by_name.iter().find(|(other, _)| *other == name).map(|(_, value)| value.clone()).ok_or("it is none of them")
    };
    PossibleValuesParser::new(choices.iter().map(possible)).try_map(find)
}

/// Returns a choice as clap lists it.
pub fn possible(choice: &Choice) -> PossibleValue {
    PossibleValue::new(choice.name).help(choice.documentation.trim_end_matches('.').to_owned())
}

#[cfg(test)]
mod tests {
    use std::ffi::OsString;
    use std::path::PathBuf;

    use super::pipeline_folder;

    #[test]
    fn a_user_names_a_folder_for_pipelines_or_has_one() {
        let caches = || Some(PathBuf::from("/caches"));
        assert_eq!(pipeline_folder(None, caches()), Some(PathBuf::from("/caches/stein")));
        assert_eq!(pipeline_folder(Some("/elsewhere".into()), caches()), Some(PathBuf::from("/elsewhere")));
        assert_eq!((pipeline_folder(Some(OsString::new()), caches()), pipeline_folder(None, None)), (None, None));
    }
}
