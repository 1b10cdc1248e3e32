//! Variances in other quantities than the variance of the mean.

use stein::error::Remedy;
use stein_exr::{LayerRef, Quantity};

use super::*;

fn pbrt() -> Part {
    Part::new()
        .with("", "RGB", 1.0)
        .with("Albedo", "RGB", 2.0)
        .with("Ns", "XYZ", 3.0)
        .with("RelativeVariance", "RGB", 4.0)
        .with("Variance", "RGB", 32.0)
}

#[test]
fn the_variance_of_one_sample_is_divided_by_the_samples_or_they_are_asked_for() {
    let folder = folder();
    let input = write(folder.path(), "in.exr", vec![pbrt().attribute("samplesPerPixel", AttributeValue::I32(32))]);
    let set = read(&input);
    assert_eq!(set.layout().name, "pbrt");
    let variance = set.color().variance_of_mean.unwrap();
    let expected: Vec<f32> = ramp(32.0, PIXELS).iter().map(|value| value / 32.0).collect();
    assert_eq!(variance.planes[0], expected);
    let found = set.layer_uses().iter().find(|layer| layer.layer == "Variance").unwrap();
    assert_eq!((&found.role, found.quantity), (&Role::Variance, Some(Quantity::VarianceOfSample)));

    let input = write(folder.path(), "in.exr", vec![pbrt()]);
    let error = BufferSet::read(&request(&input)).map(drop).unwrap_err();
    assert!(error.to_string().contains("variance of one sample"), "{error}");
    assert_eq!(error.remedies(), [Remedy::GiveSamples]);
    let set = BufferSet::read(&BufferSetRequest { samples: Some(16), ..request(&input) }).unwrap();
    assert_eq!(set.color().variance_of_mean.unwrap().planes[0][0], 2.0);
    // With halves, nothing has to be asked for.
    let part = pbrt().with("halfA", "RGB", 1.0).with("halfB", "RGB", 1.5);
    let set = read(&write(folder.path(), "in.exr", vec![part]));
    assert_eq!(set.color().variance_of_mean, None);
    assert!(note(&set, "Variance").contains("how many samples"));
}

#[test]
fn a_variance_of_0_that_means_unknown_is_estimated_from_the_image() {
    let folder = folder();
    let mut part = pbrt().attribute("samplesPerPixel", AttributeValue::I32(32));
    for (name, samples) in &mut part.channels {
        match (name.as_str(), samples) {
            ("Variance.R", FlatSamples::F32(values)) => values[7] = 0.0,
            // Noise of one pixel, which the estimate sees.
            ("R", FlatSamples::F32(values)) => values[7] += 40.0,
            _ => {}
        }
    }
    let set = read(&write(folder.path(), "in.exr", vec![part]));
    let variance = set.color().variance_of_mean.unwrap();
    assert!(variance.planes[0][7] > 1.0, "{}", variance.planes[0][7]);
    assert_eq!(variance.planes[0][6], 38.0 / 32.0);
}

#[test]
fn known_wrong_meanings_are_refused_as_a_variance_by_name() {
    let folder = folder();
    let part = Part::native().with("noiseLevel", "RGB", 9.0).with("RelativeVariance", "RGB", 9.0);
    let input = write(folder.path(), "in.exr", vec![part.with("Variance", "RGB", 9.0)]);
    for (layer, why) in [("noiseLevel", "heuristic"), ("RelativeVariance", "by the mean"), ("Variance", "one sample")] {
        let variance = Some(LayerRef { file: input.clone(), layer: Some(layer.into()) });
        let message = failure(&BufferSetRequest { variance, ..request(&input) });
        assert!(message.contains(layer) && message.contains(why), "{message}");
    }
}

#[test]
fn a_fraction_of_the_samples_in_the_header_becomes_a_count() {
    let folder = folder();
    let mut part =
        Part::new().with("v.Combined", "RGBA", 1.0).attribute("cycles.v.samples", AttributeValue::Text("64".into()));
    part.channels.push(("v.Debug Sample Count.X".into(), FlatSamples::F32(vec![0.25; PIXELS])));
    let set = read(&write(folder.path(), "in.exr", vec![part]));
    let counts = stein::frame::SamplesPerPixel::PerPixel(Planes { planes: vec![vec![16.0; PIXELS]], ..rgb(0.0) });
    assert_eq!((set.layout().name.as_str(), set.samples_per_pixel()), ("cycles", counts));
}

#[test]
fn the_rules_of_a_layout_come_before_usual_names() {
    let folder = folder();
    let part = Part::new()
        .with("sky.beauty", "RGB", 1.0)
        .with("sky.beauty_var", "RGB", 16.0)
        .attribute("ours.sky.spp", AttributeValue::I32(16));
    let input = write(folder.path(), "in.exr", vec![part]);
    let layout = folder.path().join("ours.toml");
    let document = "title = \"Ours\"\n[samples]\nattributes = [\"ours.{group}spp\"]\n[[layer]]\n\
                    name = \"{group}beauty\"\nrole = \"color\"\n[[layer]]\nname = \"{group}beauty_var\"\n\
                    role = \"color\"\nquantity = \"variance of one sample\"\n";
    std::fs::write(&layout, document).unwrap();
    let asked = BufferSetRequest { layout: Some(layout.to_str().unwrap().into()), ..request(&input) };
    assert_eq!(BufferSet::read(&asked).unwrap().color().variance_of_mean.unwrap().planes[0][0], 1.0);
}

#[test]
fn a_layout_of_the_users_own_is_read_from_a_file() {
    let folder = folder();
    let part = Part::new().with("bild", "RGB", 1.0).with("farbe", "RGB", 2.0).with("bild_rauschen", "RGB", 3.0);
    let input = write(folder.path(), "in.exr", vec![part]);
    let layout = folder.path().join("eigen.toml");
    let document = "title = \"Own\"\n[[layer]]\nname = \"bild\"\nrole = \"color\"\n[[layer]]\nname = \"farbe\"\n\
                    role = \"albedo\"\n[[layer]]\nname = \"{of}_rauschen\"\nquantity = \"variance of the mean\"\n";
    std::fs::write(&layout, document).unwrap();
    let asked = BufferSetRequest { layout: Some(layout.to_str().unwrap().into()), ..request(&input) };
    let set = BufferSet::read(&asked).unwrap();
    assert_eq!((set.layout().name.as_str(), set.color().mean.clone()), ("eigen", rgb(1.0)));
    assert_eq!(set.color().variance_of_mean, Some(rgb(3.0)));
    assert_eq!(set.feature_names().collect::<Vec<_>>(), ["albedo"]);
    std::fs::write(&layout, "title = \"Own\"\n[[layer]]\nname = \"bild\"\nrole = \"farbe\"\n").unwrap();
    let message = failure(&asked);
    assert!(message.contains("eigen.toml") && message.contains("line 4"), "{message}");
    let message = failure(&BufferSetRequest { layout: Some("cicles".into()), ..request(&input) });
    assert!(message.contains("cycles"), "{message}");
}
