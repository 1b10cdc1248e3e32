//! `stein bench`, as a process: what it measures, writes, compares and refuses.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

#[allow(dead_code, unreachable_pub, reason = "every test includes all shared pieces and uses a part of them")]
#[path = "common/frames.rs"]
mod frames;
#[allow(dead_code, unreachable_pub, reason = "every test includes all shared pieces and uses a part of them")]
#[path = "common/process.rs"]
mod process;

use std::path::Path;
use stein::frame::RawSignal;

use process::{Folder, stein, test_image, write_without};
use serde_json::{Value, json};
use stein::Image;
use stein_exr::{NamedLayer, write_layers};

/// Left, top, width and height: a small rectangle, so that a software adapter is done at once.
const CROP: [usize; 4] = [20, 30, 40, 32];

fn crop(image: &Image) -> Image {
    let [left, top, width, height] = CROP;
    frames::cropped(image, left, top, width, height)
}

/// Writes a rectangle of a test render to a file of its own, with halves, variances and one feature.
fn write_crop(name: &str, samples: u32, file: &str) {
    let set = frames::noisy(name);
    let mut layers = Vec::new();
    let mut add = |mean: &str, part: &str, raw: RawSignal, names: &[&str]| {
        let mut layer = |name: String, image: Image| {
            layers.push(NamedLayer {
                name,
                channels: names.iter().map(ToString::to_string).collect(),
                image: crop(&image),
            });
        };
        layer(mean.into(), raw.mean);
        layer(format!("{part}halfA"), raw.half_a.unwrap());
        layer(format!("{part}halfB"), raw.half_b.unwrap());
        layer(format!("{part}variance"), raw.variance_of_mean.unwrap());
    };
    add("", "", set.color(), &["R", "G", "B"]);
    let (_, albedo) = set.features().find(|(name, _)| *name == "albedo").unwrap();
    add("albedo", "albedo_", albedo, &["R", "G", "B"]);
    let path = Path::new(file);
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    write_layers(path, &layers, &[("samples".into(), samples.to_string())]).unwrap();
}

fn write_reference(scene: &str, file: &str) {
    let layer = NamedLayer {
        name: String::new(),
        channels: ["R", "G", "B"].map(String::from).to_vec(),
        image: crop(&frames::converged(scene)),
    };
    write_layers(Path::new(file), &[layer], &[]).unwrap();
}

/// Two sets of one scene and their reference, in the folder `renders`.
fn renders() -> Folder {
    let folder = Folder::new();
    for samples in [8, 32] {
        write_crop(
            &format!("cornell_{samples}spp"),
            samples,
            &folder.path(&format!("renders/box/spp{samples}/input.exr")),
        );
    }
    write_reference("cornell", &folder.path("renders/box/reference.exr"));
    folder
}

fn external(name: &str, more: &str) -> String {
    format!("--external={name}='{}' denoise {{in}} -o {{out}} {more}", env!("CARGO_BIN_EXE_stein"))
}

fn row<'a>(document: &'a Value, set: &str, configuration: &str) -> &'a Value {
    let rows = document["rows"].as_array().unwrap();
    rows.iter()
        .find(|row| row["set"] == set && row["configuration"] == configuration)
        .unwrap_or_else(|| panic!("no {set}, {configuration}"))
}

#[test]
fn a_report_tells_the_same_to_people_and_to_programs() {
    let folder = renders();
    let (sets, report) = (folder.path("renders"), folder.path("report"));
    // Other files in a folder of renders.
    let (input, denoised) =
        (folder.path("renders/box/spp8/input.exr"), folder.path("renders/box/spp8/input.denoised.exr"));
    stein(&["denoise", &input, "-o", &denoised, "--radius=1"]).succeeded();
    std::fs::write(folder.path("renders/box/broken.exr"), "not an image").unwrap();

    let arguments = [
        "bench",
        &sets,
        "--methods=dfc,gem",
        "--presets=default",
        "--radii=1,2",
        "--second-pass=on,off",
        "--repeat=1",
        "-o",
        &report,
        "--json",
    ];
    let document =
        stein(&[&arguments[..], &[&external("again <&>", "--radius=2 --quiet")]].concat()).succeeded().json();

    assert_eq!(
        (&document["schema"], &document["version"], &document["repeats"]),
        (&json!("stein.bench"), &json!(2), &json!(1))
    );
    assert!(document["adapter"]["driver"].as_str().is_some_and(|driver| !driver.is_empty()));
    let names = |list: &str, key: &str| {
        document[list].as_array().unwrap().iter().map(|of| of[key].as_str().unwrap().to_owned()).collect::<Vec<_>>()
    };
    assert_eq!(names("sets", "name"), ["box, 8 spp", "box, 32 spp"]);
    assert_eq!(
        names("configurations", "name"),
        ["dfc R1", "dfc R2", "dfc one pass R1", "dfc one pass R2", "gem", "again <&>"]
    );
    let notes = document["notes"].to_string();
    for note in [
        "--radii is no option of gem",
        "--second-pass is no option of gem",
        "broken.exr",
        "input.denoised.exr: was written by stein",
    ] {
        assert!(notes.contains(note), "no '{note}' in {notes}");
    }

    let rows = document["rows"].as_array().unwrap();
    assert_eq!(rows.len(), 12);
    for of in rows {
        let number = |key: &str| of[key].as_f64();
        assert!(number("wall_ms").unwrap() > 0.0 && number("first_ms").unwrap() > 0.0, "{of}");
        for measure in ["relative_mse", "mse", "ssim", "flip"] {
            assert!(of["errors"][measure].as_f64().is_some_and(|error| error.is_finite()), "{of}");
        }
        let is_stein = of["configuration"] != "again <&>";
        assert_eq!(
            (
                number("predicted_mse").is_some(),
                number("peak_bytes").is_some(),
                number("device_ms").is_some(),
                number("cpu_ms").is_some()
            ),
            (is_stein, is_stein, is_stein, is_stein),
            "{of}"
        );
        let stages: f64 = of["stages"].as_array().unwrap().iter().map(|stage| stage["ms"].as_f64().unwrap()).sum();
        assert!((stages - number("device_ms").unwrap_or(0.0)).abs() <= 1e-9 * stages);

        // No row is both faster and better than a row on the front.
        let point = |row: &Value| (row["wall_ms"].as_f64().unwrap(), row["errors"]["relative_mse"].as_f64().unwrap());
        let rivals = rows.iter().filter(|other| other["set"] == of["set"]).map(point);
        let (time, error) = point(of);
        let is_beaten = rivals.into_iter().any(|(t, e)| t <= time && e <= error && (t, e) != (time, error));
        assert_eq!(of["on_front"], !is_beaten, "{of}");
    }
    for set in ["box, 8 spp", "box, 32 spp"] {
        let error = |name: &str| row(&document, set, name)["errors"]["relative_mse"].as_f64().unwrap();
        // Stein itself as another program, by way of files.
        assert!((error("again <&>") / error("dfc R2") - 1.0).abs() < 1e-6);
        assert_ne!(error("dfc R2"), error("dfc one pass R2"));
    }

    let mut files: Vec<_> =
        std::fs::read_dir(&report).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
    files.sort();
    assert_eq!(files, ["index.html", "results.csv", "results.json"]);
    let read = |file: &str| std::fs::read_to_string(Path::new(&report).join(file)).unwrap();
    assert_eq!(serde_json::from_str::<Value>(&read("results.json")).unwrap(), document);

    // Numbers read from JSON may differ in the last digit.
    let near = |cell: &str, value: &Value| {
        cell.parse::<f64>().is_ok_and(|cell| (cell - value.as_f64().unwrap()).abs() <= 1e-12 * cell.abs())
    };
    let mut csv = csv::Reader::from_reader(read("results.csv").into_bytes().leak() as &[u8]);
    let head: Vec<String> = csv.headers().unwrap().iter().map(str::to_owned).collect();
    let records: Vec<csv::StringRecord> = csv.records().map(Result::unwrap).collect();
    assert_eq!(records.len(), rows.len());
    for (record, row) in records.iter().zip(rows) {
        let cell = |name: &str| {
            record[head.iter().position(|column| column == name).unwrap_or_else(|| panic!("no {name} in {head:?}"))]
                .to_owned()
        };
        assert_eq!(
            (cell("set"), cell("configuration")),
            (row["set"].as_str().unwrap().into(), row["configuration"].as_str().unwrap().into())
        );
        for (name, value) in [
            ("wall_ms", &row["wall_ms"]),
            ("relative_mse", &row["errors"]["relative_mse"]),
            ("flip", &row["errors"]["flip"]),
        ] {
            assert!(near(&cell(name), value), "{name}: {} {value}", cell(name));
        }
        for stage in row["stages"].as_array().unwrap() {
            assert!(near(&cell(&format!("{}_ms", stage["stage"].as_str().unwrap())), &stage["ms"]), "{stage}");
        }
        assert!(cell("noisy_mse").parse::<f64>().is_ok());
    }

    let page = read("index.html");
    // The page fetches nothing from the network.
    for address in ["http:", "https:", "//cdn", "<link", "<script", "@import", "url("] {
        assert!(!page.contains(address), "{address}");
    }
    let sources = page.matches("src=\"").count();
    assert!(sources > 0 && sources == page.matches("src=\"data:image/png;base64,").count());
    // Pictures of each set: noisy, the four best, and the reference.
    assert_eq!(page.matches("<figure>").count(), 2 * 6);
    assert!(page.contains("again &lt;&amp;&gt;") && !page.contains("again <&>"));
    // Plots over time (all sets and each), over samples, of stages, of predictions, over the window.
    assert_eq!(
        (page.matches("<svg class=\"plot\"").count(), page.matches("<svg class=\"bars\"").count()),
        (3 + 1 + 1 + 1, 1)
    );
    assert!(
        page.contains("class=\"ring\"")
            && page.contains("Fitted exponents")
            && page.contains("give several with --size")
    );
    assert_eq!(page.matches("<svg").count(), page.matches("</svg>").count());
    assert!(!page.contains("NaN"), "something was drawn that is no number");

    // A report replaces an earlier one, but no other files.
    stein(&["bench", &input, "--methods=gem", "--presets=default", "--repeat=1", "-o", &report])
        .succeeded()
        .said(&["index.html"]);
    assert_eq!(serde_json::from_str::<Value>(&read("results.json")).unwrap()["rows"].as_array().unwrap().len(), 1);
    std::fs::write(Path::new(&report).join("thoughts.txt"), "mine").unwrap();
    stein(&["bench", &input, "-o", &report]).failed(5, &["is no report", "remedy: "]);
    assert_eq!(read("thoughts.txt"), "mine");
}

#[test]
fn people_see_a_row_for_each_configuration() {
    let (input, reference) = (test_image("dof_spheres_32spp.exr"), test_image("dof_spheres_reference.exr"));
    let arguments = ["bench", &input, "--repeat=1", "--size=64x40,32x20", "--radius=2"];
    let text = stein(&[&arguments[..], &["--preset=default", "--methods=nlm", "-v"]].concat()).succeeded();
    text.said(&[
        "dof_spheres, 32 spp, 64×40",
        "32×20",
        "noisy relative MSE",
        "ms/megapixel",
        "memory",
        "predicted MSE",
        "nlm R2",
        "nlm_weight",
    ]);
    let document = stein(&[&arguments[..], &["--ref", &reference, "--json"]].concat()).succeeded().json();
    assert_eq!((&document["sets"][0]["width"], &document["sets"][0]["height"]), (&64.into(), &40.into()));
    let names: Vec<&str> =
        document["configurations"].as_array().unwrap().iter().map(|of| of["name"].as_str().unwrap()).collect();
    assert_eq!(names, ["dfc R2", "dfc thesis R2"]);
    for of in document["rows"].as_array().unwrap() {
        let set = document["sets"].as_array().unwrap().iter().find(|set| set["name"] == of["set"]).unwrap();
        assert!(of["errors"]["relative_mse"].as_f64() < set["noisy"]["relative_mse"].as_f64());
    }

    // The axes --candidates and --everything.
    let axes = ["bench", &input, "--repeat=1", "--size=32x20", "--radius=2", "--presets=default", "--methods=dfc,gem"];
    let document = stein(&[&axes[..], &["--candidates=first+second,all", "--everything=on,off", "--json"]].concat())
        .succeeded()
        .json();
    let errors: Vec<(&str, f64)> = document["rows"]
        .as_array()
        .unwrap()
        .iter()
        .map(|of| (of["configuration"].as_str().unwrap(), of["errors"]["mse"].as_f64().unwrap()))
        .collect();
    let names: Vec<&str> = errors.iter().map(|(name, _)| *name).collect();
    assert_eq!(
        names,
        [
            "dfc first+second everything R2",
            "dfc everything R2",
            "dfc first+second R2",
            "dfc R2",
            "gem everything",
            "gem"
        ]
    );
    for (everything, without) in [(0, 2), (1, 3), (4, 5)] {
        assert!((errors[everything].1 / errors[without].1 - 1.0).abs() < 1e-3, "{errors:?}");
    }
    assert_ne!(errors[2].1, errors[3].1);

    // Without a reference everything except errors is reported.
    let folder = Folder::new();
    let lone = folder.path("lone.exr");
    write_crop("cornell_8spp", 8, &lone);
    // Parameters from a file give the configuration a name of its own.
    let file = folder.path("own.toml");
    std::fs::write(&file, "method = 'gem'\npreset = 'thesis'\ngamma = 0.2\nspikes = 'clamp'").unwrap();
    let text = stein(&["bench", &lone, "--params", &file, "--repeat=1"]).succeeded();
    text.said(&["lone, 8 spp", "no reference", "wall ms", "predicted MSE", "gem thesis gamma 0.2 spikes clamp"]);
    assert!(!text.stdout.contains("relative MSE"), "{}", text.stdout);
}

#[test]
fn what_is_known_of_the_noise_is_measured_side_by_side() {
    let folder = renders();
    let (input, report) = (folder.path("renders/box/spp8/input.exr"), folder.path("report"));
    let arguments = ["--methods=dfc,gem", "--presets=default", "--radius=2", "--repeat=1", "--json"];
    let bench = |input: &str, more: &[&str]| stein(&[&["bench", input], &arguments[..], more].concat());
    let document = bench(&input, &["--noise=given,halves,image,halves", "-o", &report]).succeeded().json();
    let names: Vec<&str> =
        document["configurations"].as_array().unwrap().iter().map(|of| of["name"].as_str().unwrap()).collect();
    assert_eq!(
        names,
        ["dfc R2", "dfc noise halves R2", "dfc noise image R2", "gem", "gem noise halves", "gem noise image"]
    );
    let told: Vec<&str> = document["configurations"]
        .as_array()
        .unwrap()
        .iter()
        .map(|of| of["stein"]["noise"].as_str().unwrap())
        .collect();
    assert_eq!(told, ["given", "halves", "image", "given", "halves", "image"]);
    let error =
        |document: &Value, name: &str| row(document, "box, 8 spp", name)["errors"]["relative_mse"].as_f64().unwrap();
    for method in ["dfc{} R2", "gem{}"] {
        let errors = ["", " noise halves", " noise image"].map(|noise| error(&document, &method.replace("{}", noise)));
        assert!(
            errors[0] != errors[1] && errors[1] != errors[2] && errors.iter().all(|error| *error > 0.0),
            "{method}: {errors:?}"
        );
    }
    for of in document["rows"].as_array().unwrap() {
        assert!(of["wall_ms"].as_f64().unwrap() > 0.0 && of["peak_bytes"].is_u64(), "{of}");
    }
    let read = |file: &str| std::fs::read_to_string(Path::new(&report).join(file)).unwrap();
    let csv = read("results.csv");
    let column = csv.lines().next().unwrap().split(',').position(|name| name == "noise").unwrap();
    let mut records = csv::Reader::from_reader(csv.as_bytes());
    assert_eq!(records.records().map(|record| record.unwrap()[column].to_owned()).collect::<Vec<_>>(), told);
    assert!(read("index.html").contains("dfc noise image R2"));

    // The result equals that of a file without the other layers; with gem, which uses no features.
    let only = |name: &str, parts: &[&str]| {
        let file = folder.path(&format!("{name}.exr"));
        write_without(parts, &input, &file);
        let document =
            bench(&file, &["--methods=gem", "--ref", &folder.path("renders/box/reference.exr")]).succeeded().json();
        let set = document["sets"][0]["name"].as_str().unwrap();
        row(&document, set, "gem")["errors"]["relative_mse"].as_f64().unwrap()
    };
    assert_eq!(only("halves", &["variance"]), error(&document, "gem noise halves"));

    // A set that has no halves.
    let bare = folder.path("renders/bare.exr");
    write_without(&["halfA", "halfB"], &input, &bare);
    bench(&bare, &["--noise=halves"]).failed(3, &["bare.exr: --noise halves", "no halves", "remedy: "]);
    let document = bench(&folder.path("renders"), &["--noise=halves"]).succeeded().json();
    assert_eq!(document["sets"].as_array().unwrap().len(), 2);
    assert!(
        document["notes"].to_string().contains("left out: ") && document["notes"].to_string().contains("bare.exr"),
        "{}",
        document["notes"]
    );
    bench(&input, &["--noise=none"]).failed(2, &["--noise", "given, halves, image"]);
}

#[test]
fn a_run_is_compared_with_an_earlier_one_and_measured_again() {
    let folder = renders();
    let (sets, before) = (folder.path("renders"), folder.path("before.json"));
    let first = stein(&["bench", &sets, "--methods=gem", "--repeat=1", "--json"]).succeeded();
    let write = |change: &dyn Fn(&mut Value)| {
        let mut document = first.json();
        change(&mut document);
        std::fs::write(&before, document.to_string()).unwrap();
    };
    let ratio = |document: &Value, key: &str| document["comparison"]["rows"][0][key].as_f64();

    write(&|document| {
        for row in document["rows"].as_array_mut().unwrap() {
            row["wall_ms"] = json!(row["wall_ms"].as_f64().unwrap() * 1e3);
            row["stages"][0]["ms"] = json!(1e9);
        }
    });
    // The same rows are measured again, with the same bits.
    let document = stein(&["bench", "--compare", &before, "--json", "--fail-above=1.5"]).succeeded().json();
    assert_eq!(document["rows"].as_array().unwrap().len(), 4);
    assert!(ratio(&document, "wall").unwrap() < 0.1);
    assert_eq!(ratio(&document, "relative_mse"), Some(1.0));
    let stage = &document["comparison"]["rows"][0]["stages"][0];
    assert!(stage[1].as_f64().unwrap() < 0.01, "{stage}");

    write(&|document| {
        document["rows"][1]["errors"]["relative_mse"] = json!(1e-9);
        document["rows"][2]["configuration"] = json!("gem forgotten");
        for row in document["rows"].as_array_mut().unwrap() {
            row["wall_ms"] = json!(1e9);
        }
    });
    let again = stein(&["bench", &sets, "--methods=gem", "--repeat=1", "--compare", &before]).succeeded();
    again.said(&[
        "new / old",
        "worse",
        "1 rows have no partner in the old run",
        "1 rows have no partner in the new run",
        "the old run was of",
    ]);
    stein(&["bench", "--compare", &before, "--fail-above=2"]).failed(1, &["box, 8 spp, gem thesis"]);

    write(&|document| document["adapter"]["name"] = json!("Voodoo 2"));
    stein(&["bench", "--compare", &before, "--repeat=2"]).succeeded().said(&[
        "ANOTHER ADAPTER",
        "Voodoo 2",
        "median of 2",
    ]);
    stein(&["bench", "--compare", &before, "--fail-above=2"]).failed(2, &["Voodoo 2", "remedy: "]);
    stein(&["bench", "--compare", &before, "--methods=nlm"]).failed(2, &["without SETS", "remedy: "]);
    write(&|document| document["version"] = json!(3));
    stein(&["bench", "--compare", &before]).failed(3, &["version 3", "remedy: "]);
    std::fs::write(&before, "{}").unwrap();
    stein(&["bench", &sets, "--compare", &before]).failed(3, &["was not written by `stein bench`", "remedy: "]);
}

#[test]
fn other_programs_that_fail_are_told_with_what_they_said() {
    let folder = renders();
    let input = folder.path("renders/box/spp8/input.exr");
    let bench = |external: &str| stein(&["bench", &input, "--methods=gem", "--repeat=1", external]);
    bench(&external("picky", "--radius=100"))
        .failed(3, &["--external picky", "exit code 2", "`window_radius` cannot be 100", "remedy: "]);
    bench("--external=lost=no-such-program {in} {out}")
        .failed(3, &["--external lost", "cannot be run", "no-such-program"]);
    bench(&external("idle", "--dry-run")).failed(3, &["--external idle", "did not write its output"]);
    bench("--external=half=tool {in}").failed(2, &["{out}"]);
    bench("--external=gem=tool {in} {out}").failed(2, &["two configurations of the name gem"]);
}

#[test]
fn options_that_none_of_the_methods_has_are_refused() {
    let input = test_image("cornell_8spp.exr");
    stein(&["bench", &input, "--methods=gem", "--radii=5"])
        .failed(2, &["--radii is no option of the method gem", "remedy: "]);
    stein(&["bench", &input, "--methods=nlm,gem", "--second-pass=off"])
        .failed(2, &["--second-pass is no option of the method nlm or gem", "remedy: "]);
    stein(&["bench", &input, "--methods=nlm", "--candidates=first"])
        .failed(2, &["--candidates is no option of the method nlm", "remedy: "]);
    stein(&["bench", &input, "--candidates=first+fourth"]).failed(2, &["first+second"]);
    stein(&["bench", &input, "--methods=dfc,gem", "--set=k=0.3"])
        .failed(2, &["`k` is no parameter of dfc, but of nlm"]);
    stein(&["bench", &input, "--methods=nlm,gem", "--skip-feature=depth"]).failed(2, &["uses no features"]);
    stein(&["bench", &input, "--radii=5,100"]).failed(2, &["`window_radius` cannot be 100"]);
    stein(&["bench", &input, "--fail-above=2"]).failed(2, &["--compare"]);
    stein(&["bench"]).failed(2, &["SETS"]);
    let folder = Folder::new();
    stein(&["bench", &folder.path("")]).failed(3, &["holds no OpenEXR file", "remedy: "]);
    stein(&["bench", &folder.path(""), "--ref", &input]).failed(2, &["this is a folder", "remedy: "]);
    stein(&["bench", &folder.path("missing.exr")]).failed(3, &["missing.exr", "remedy: "]);
}
