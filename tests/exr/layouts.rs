//! Layouts of renderers: what each layer is taken for.

use std::path::Path;

use serde::Deserialize;
use stein_exr::{BufferSet, BufferSetRequest, LayerUse, Quantity, Role, SignalPart};

#[derive(Deserialize)]
struct Expected {
    input: Vec<Input>,
}

#[derive(Deserialize)]
struct Input {
    file: String,
    layout: String,
    uses: Vec<String>,
}

/// Writes the use of a layer as `expected.toml` does.
fn told(input: &Path, layer: &LayerUse) -> String {
    let mut name = layer.layer.clone();
    let is_alone = layer.channels.len() == 1 && layer.layer.eq_ignore_ascii_case("a");
    if name.is_empty() || is_alone {
        let letter = |channel: &String| channel[..1].to_uppercase();
        name = layer.channels.iter().map(letter).collect::<Vec<_>>().join(" ");
    }
    if layer.file != input {
        name = format!("{}::{name}", layer.file.file_name().unwrap().to_string_lossy());
    }
    let quantity = layer.quantity.unwrap_or(Quantity::VarianceOfMean).to_string();
    let of = |role: &str, part: SignalPart| match part {
        SignalPart::Mean => role.to_owned(),
        SignalPart::HalfA => format!("{role}, half a"),
        SignalPart::HalfB => format!("{role}, half b"),
        SignalPart::Variance => format!("{role}, {quantity}"),
    };
    let role = match &layer.role {
        Role::Color => of("color", SignalPart::Mean),
        Role::HalfA => of("color", SignalPart::HalfA),
        Role::HalfB => of("color", SignalPart::HalfB),
        Role::Variance => of("color", SignalPart::Variance),
        Role::Feature(name, part) => {
            let known = ["albedo", "normal", "depth", "position", "visibility", "caustic"];
            of(if known.contains(&name.as_str()) { name } else { "feature" }, *part)
        }
        Role::Samples => "samples".into(),
        Role::Alpha => "alpha".into(),
        Role::Light if layer.quantity.is_some() => of("light", SignalPart::Variance),
        Role::Light => "light".into(),
        Role::Id => "id".into(),
        Role::Denoised => "denoised".into(),
        Role::Untouched => "not used".into(),
    };
    format!("{name}: {role}")
}

#[test]
fn every_layer_is_taken_for_what_its_renderer_means() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("testdata/layouts");
    let expected: Expected = toml::from_str(&std::fs::read_to_string(folder.join("expected.toml")).unwrap()).unwrap();
    let mut wrong = Vec::new();
    for Input { file, layout, mut uses } in expected.input {
        let input = folder.join(&file);
        let request = BufferSetRequest { input: input.clone(), ..Default::default() };
        // Some files need the number of samples and do not tell it.
        let read = BufferSet::read(&request);
        let set = match read.or_else(|_| BufferSet::read(&BufferSetRequest { samples: Some(16), ..request })) {
            Ok(set) => set,
            Err(error) => {
                wrong.push(format!("{file}: {error}"));
                continue;
            }
        };
        if set.layout().name != layout {
            wrong.push(format!("{file}: {:?}, not {layout}", set.layout()));
        }
        let mut found: Vec<String> = set.layer_uses().iter().map(|layer| told(&input, layer)).collect();
        found.sort();
        // How a count of samples is stored does not matter once it is read.
        uses.iter_mut().for_each(|text| *text = text.replace(", count", "").replace(", fraction", ""));
        uses.sort();
        let missing = uses.iter().filter(|text| !found.contains(text)).map(|text| format!("{file}: missing {text}"));
        let other = found.iter().filter(|text| !uses.contains(text)).map(|text| format!("{file}: found {text}"));
        wrong.extend(missing.chain(other));
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}
