//! Parameters describe themselves; parameters as TOML.

use std::collections::BTreeSet;
use std::ops::Bound;

use serde_json::Value as Json;
use stein::method::dfc::SecondPass;
use stein::parameters::{Kind, Parameter, Value};
use stein::stage::select::Guard;
use stein::{DfcParams, Error, Method, Preset};

fn presets() -> impl Iterator<Item = (Method, Preset)> {
    Method::all()
        .into_iter()
        .flat_map(|method| Preset::ALL.iter().map(move |preset| (method.of_preset(*preset), *preset)))
}

fn find(method: &Method, name: &str) -> Parameter {
    method.parameters().into_iter().find(|parameter| parameter.name == name).unwrap_or_else(|| panic!("no {name}"))
}

fn set(method: Method, name: &str, value: impl Into<Value>) -> Method {
    method.with_parameter(name, value).unwrap_or_else(|error| panic!("{error}"))
}

#[track_caller]
fn assert_refused<T: std::fmt::Debug>(result: Result<T, Error>, said: &[&str]) {
    let Err(error @ Error::Request(_)) = result else { panic!("accepted: {result:?}") };
    let message = error.to_string();
    for words in said {
        assert!(message.contains(words), "no '{words}' in: {message}");
    }
}

/// Other values that the parameter may have: the ends of its range, and a number that needs all digits.
fn others(parameter: &Parameter) -> Vec<Value> {
    let all = match &parameter.kind {
        Kind::Integer { range } => vec![Value::Integer(*range.start()), Value::Integer(*range.end())],
        Kind::Number { range, can_be_off } => {
            let ends = [range.0, range.1].into_iter().map(|bound| match bound {
                Bound::Included(end) => end,
                Bound::Excluded(0.0) => f32::MIN_POSITIVE,
                Bound::Excluded(end) => end.next_down(),
                Bound::Unbounded => f32::MAX,
            });
            let number = match parameter.value {
                Some(Value::Number(number)) => number,
                _ => 1.0,
            };
            ends.chain([number.next_up()]).map(Value::Number).chain(can_be_off.then_some(Value::Flag(false))).collect()
        }
        Kind::Flag | Kind::Group => vec![Value::Flag(true), Value::Flag(false)],
        Kind::Choice { options } => options.iter().map(|option| option.name.into()).collect(),
        Kind::Set { options } => options.iter().map(|option| [option.name].into()).collect(),
    };
    all.into_iter().filter(|value| Some(value) != parameter.value.as_ref()).collect()
}

#[test]
fn every_parameter_is_documented() {
    for method in Method::all() {
        let parameters = method.parameters();
        let names: BTreeSet<_> = parameters.iter().map(|parameter| &parameter.name).collect();
        assert_eq!(names.len(), parameters.len(), "{}: a name twice", method.name());
        for parameter in &parameters {
            let Parameter { name, documentation, kind, .. } = parameter;
            let options: &[_] = if let Kind::Choice { options } | Kind::Set { options } = kind { options } else { &[] };
            for text in options.iter().map(|option| &option.documentation).chain([documentation]) {
                // A panel shows the text unchanged.
                assert!(text.ends_with('.') && !text.contains("](") && !text.contains("  "), "{name}: {text}");
            }
            assert!(
                documentation.starts_with(parameter.summary()) && parameter.summary().ends_with('.'),
                "{name}: {}",
                parameter.summary()
            );
        }
    }
    assert_eq!(
        find(&Method::default(), "covariance").summary(),
        "Factor of the last term of SURE, 2σ²·dF/du (eq. 8.5)."
    );
}

#[test]
fn names_and_values_are_those_of_the_struct() {
    fn flatten(prefix: &str, value: &Json, into: &mut Vec<(String, Json)>) {
        match value {
            Json::Object(members) if !prefix.is_empty() || members.contains_key("method") => {
                if !prefix.is_empty() {
                    into.push((prefix.to_owned(), true.into()));
                }
                for (name, value) in members.iter().filter(|(name, _)| *name != "method") {
                    flatten(&if prefix.is_empty() { name.clone() } else { format!("{prefix}.{name}") }, value, into);
                }
            }
            Json::Null => into.push((prefix.to_owned(), false.into())),
            value => into.push((prefix.to_owned(), value.clone())),
        }
    }
    for (method, preset) in presets() {
        let mut of_struct = Vec::new();
        flatten("", &serde_json::to_value(method).unwrap_or_else(|error| panic!("{error}")), &mut of_struct);
        // A group that cannot be left out is no parameter itself.
        of_struct.retain(|(name, _)| name != "weighting");
        of_struct.sort_by(|a, b| a.0.cmp(&b.0));
        let shown = |value: Value| match value {
            Value::Integer(number) => number.into(),
            Value::Number(number) => number.into(),
            Value::Flag(flag) => flag.into(),
            // JSON documents name these two by their variants.
            Value::Choice(word) if word == "one" => "One".into(),
            Value::Choice(word) if word == "largest-neighbour" => "LargestNeighbour".into(),
            Value::Choice(word) => word.into(),
            Value::Set(words) => words.into(),
        };
        let listed = method.parameters();
        for Parameter { name, value, default, thesis, .. } in &listed {
            assert_eq!(value, if preset == Preset::Default { default } else { thesis }, "{name}");
        }
        let mut listed: Vec<_> =
            listed.into_iter().filter_map(|parameter| Some((parameter.name, shown(parameter.value?)))).collect();
        listed.sort_by(|a, b| a.0.cmp(&b.0));
        assert_eq!(listed, of_struct);
    }
}

#[test]
fn parameters_outside_their_range_are_refused() {
    for method in Method::all() {
        for parameter in method.parameters() {
            let name = &parameter.name;
            let wrong: Vec<Value> = match &parameter.kind {
                Kind::Integer { range } => {
                    let below = range.start().checked_sub(1).map(Value::Integer);
                    below
                        .into_iter()
                        .chain([(range.end() + 1).into(), 1.5.into(), true.into(), "many".into()])
                        .collect()
                }
                Kind::Number { range, .. } => {
                    let outside = |bound: Bound<f32>, outwards: fn(f32) -> f32| match bound {
                        Bound::Included(end) => outwards(end),
                        Bound::Excluded(end) => end,
                        Bound::Unbounded => f32::INFINITY,
                    };
                    let ends = [outside(range.0, f32::next_down), outside(range.1, f32::next_up)];
                    ends.into_iter().chain([f32::NAN]).map(Value::Number).chain(["much".into()]).collect()
                }
                Kind::Flag | Kind::Group => vec![1.into(), "true".into()],
                Kind::Choice { .. } => vec!["nonsense".into(), ["spread"].into(), 1.into()],
                Kind::Set { .. } => {
                    vec!["first".into(), [].into(), ["first", "nonsense"].into(), ["first", "first"].into()]
                }
            };
            for value in wrong {
                assert!(!parameter.kind.contains(&value), "{name}: {value}");
                assert_refused(method.with_parameter(name, value), &[name, "choose"]);
            }
        }
    }
    let radius = |window_radius| Method::from(DfcParams { window_radius, ..DfcParams::default() }).validate();
    assert_refused(radius(0), &["`window_radius` cannot be 0", "a whole number from 1 to 64 pixels"]);
    assert!(radius(1).is_ok() && radius(64).is_ok());
    let guard = |own_noise| {
        Method::from(DfcParams { guard: Some(Guard { own_noise, ..Guard::default() }), ..DfcParams::default() })
            .validate()
    };
    assert_refused(guard(-1.0), &["`guard.own_noise` cannot be -1", "at least 0"]);
    let limit = |most_sigmas| {
        let second_pass = Some(SecondPass { most_sigmas, ..SecondPass::default() });
        Method::from(DfcParams { second_pass, ..DfcParams::default() }).validate()
    };
    assert_refused(limit(Some(0.0)), &["`second_pass.most_sigmas` cannot be 0", "or false to leave it out"]);
    assert!(limit(None).is_ok());
    // Together.
    assert_refused(
        Method::default().with_parameter("first_patch_radius", 4),
        &["`first_patch_radius` is 4", "`second_patch_radius` 3"],
    );
    assert_refused(
        Method::default().with_parameter("weighting.symmetric", "hard"),
        &["cannot be hard", "one of off, blended"],
    );
    assert!(set(Method::all()[2], "weighting.symmetric", "hard") == Method::all()[2]);
}

#[test]
fn names_that_are_none_are_told_with_what_there_is() {
    let [dfc, gem, nlm] = Method::all();
    assert_refused(dfc.with_parameter("windw_radius", 3), &["`windw_radius` is no parameter of dfc", "window_radius"]);
    assert_refused(dfc.with_parameter("guard.nonsense", 3), &["guard.own_noise"]);
    assert_refused(
        gem.with_parameter("window_radius", 3),
        &["`window_radius` is no parameter of gem, but of dfc and nlm"],
    );
    assert_refused(nlm.with_parameter("weighting", false), &["`weighting` is a group", "weighting.symmetric"]);
}

#[test]
fn groups_are_put_in_as_they_are_in_the_default_preset() {
    let thesis = Method::from(DfcParams::thesis());
    assert_refused(thesis.with_parameter("guard.own_noise", 1.0), &["`guard` is left out", "make `guard` true"]);
    let with = |name| set(set(Method::default(), name, false), name, true);
    for name in ["guard", "second_pass", "second_pass.most_sigmas"] {
        assert_eq!(find(&set(Method::default(), name, false), name).value, Some(Value::Flag(false)));
        assert_eq!(with(name), Method::default(), "{name}");
    }
    // A group that is present keeps its values.
    let changed = set(set(Method::default(), "guard.own_noise", 1), "second_pass.most_sigmas", 2.5);
    assert_eq!(set(set(changed, "guard", true), "second_pass.most_sigmas", true), changed);
}

#[test]
fn toml_holds_every_parameter() {
    for (method, preset) in presets() {
        let mut changed = method;
        for index in 0..method.parameters().len() {
            let there_and_back = |method: Method| {
                let document = method.to_toml(preset);
                let read = Method::from_toml(&document).unwrap_or_else(|error| panic!("{error}\n{document}"));
                assert_eq!(read, (method, preset), "{document}");
                assert!(document.lines().all(|line| line.chars().count() <= 100 && line == line.trim()), "{document}");
            };
            let Parameter { name, value: Some(_), .. } = &method.parameters()[index] else { continue };
            let changes = others(&method.parameters()[index]);
            let changes: Vec<_> =
                changes.into_iter().filter_map(|value| method.with_parameter(name, value).ok()).collect();
            assert!(!changes.is_empty() && !changes.contains(&method), "{name} has no other value");
            changes.into_iter().for_each(there_and_back);
            // All of them together, except for groups, which include their own parameters.
            let parameter = find(&changed, name);
            if parameter.kind != Kind::Group {
                changed = others(&parameter)
                    .into_iter()
                    .find_map(|value| changed.with_parameter(name, value).ok())
                    .unwrap_or(changed);
                there_and_back(changed);
            }
        }
        let differing = |other: &Method| {
            method.parameters().into_iter().zip(other.parameters()).filter(|(a, b)| a.value != b.value).count()
        };
        let groups = method
            .parameters()
            .iter()
            .filter(|parameter| parameter.kind == Kind::Group || parameter.value.is_none())
            .count();
        assert_eq!(differing(&changed), method.parameters().len() - groups, "{}", changed.to_toml(preset));
    }
}

#[test]
fn what_toml_does_not_say_is_as_in_its_preset() {
    let read = |document: &str| Method::from_toml(document).unwrap_or_else(|error| panic!("{error}\n{document}"));
    let [dfc, gem, nlm] = Method::all();
    assert_eq!(read(""), (dfc, Preset::Default));
    assert_eq!(read("preset = 'thesis'"), (dfc.of_preset(Preset::Thesis), Preset::Thesis));
    assert_eq!(read("method = \"nlm\"\npreset = \"thesis\"\nk = 1").0, set(nlm.of_preset(Preset::Thesis), "k", 1.0));
    assert_eq!(read("gamma = 2e-1\r\nmethod = \"gem\"").0, set(gem, "gamma", 0.2));
    // A table adds its group, in every notation, even if it is empty.
    let thesis = dfc.of_preset(Preset::Thesis);
    let guarded = set(set(thesis, "guard", true), "guard.own_noise", 1.0);
    for document in ["[guard]\nown_noise = 1", "guard = { own_noise = 1.0 }", "guard.own_noise = 1"] {
        assert_eq!(read(&format!("preset = \"thesis\"\n{document}")).0, guarded, "{document}");
    }
    assert_eq!(read("preset = \"thesis\"\n[guard]").0, set(thesis, "guard", true));
    assert_eq!(read("guard = false").0, set(dfc, "guard", false));
    // A whole number too large for an integer is still a number.
    assert_eq!(read("color_k = 5000000000").0, set(dfc, "color_k", 5e9));
    // A setting may contradict the others for a moment, if the final parameters agree.
    assert_eq!(
        read("first_patch_radius = 5\nsecond_patch_radius = 5").0,
        set(set(dfc, "second_patch_radius", 5), "first_patch_radius", 5)
    );
    // Digits are rounded to float32 directly, not by way of float64: this number is above the middle of two float32 by
    // less than a float64 can hold.
    let k = read("color_k = 1.00000005960464477540").0;
    assert_eq!(find(&k, "color_k").value, Some(Value::Number(1.0f32.next_up())));
}

#[test]
fn toml_that_cannot_be_meant_is_refused_with_its_line() {
    let wrong: [(&str, &[&str]); 19] = [
        ("window_radius = 10\nwindow_radius = 11", &["line 2", "duplicate key"]),
        ("window_radius 10", &["line 1", "not TOML"]),
        ("\n\n# all\nguard = ", &["line 4", "not TOML"]),
        ("method = \"dcf\"", &["line 1", "`method` cannot be \"dcf\"", "one of dfc, gem, nlm"]),
        ("method = 1", &["line 1", "`method` cannot be 1"]),
        ("preset = \"best\"", &["`preset` cannot be \"best\"", "one of default, thesis"]),
        ("color_k = 1\n\nwindw_radius = 3", &["line 3", "`windw_radius` is no parameter of dfc"]),
        ("[guard]\nown_noise = 1\nnoise = 1", &["line 3", "`guard.noise` is no parameter of dfc", "guard.own_noise"]),
        ("method = \"gem\"\n[weighting]\nsymmetric = \"off\"", &["line 2", "`weighting`", "gem"]),
        ("window_radius = 100", &["line 1", "`window_radius` cannot be 100", "a whole number from 1 to 64 pixels"]),
        ("window_radius = -1", &["`window_radius` cannot be -1"]),
        ("window_radius = 10.0", &["`window_radius` cannot be 10.0"]),
        ("window_radius = \"10\"", &["`window_radius` cannot be \"10\""]),
        ("color_k = nan", &["`color_k` cannot be nan", "above 0"]),
        ("color_k = 1e60", &["`color_k` cannot be 1e60"]),
        ("spikes = 2026-11-22", &["`spikes` cannot be 2026-11-22", "keep, spread, clamp"]),
        ("candidates = [\"first\", 2]", &["`candidates` cannot be [\"first\", 2]", "first, second, third"]),
        ("[window_radius]\npixels = 10", &["line 1", "`window_radius` cannot be a table"]),
        ("first_patch_radius = 4", &["`first_patch_radius` is 4", "no larger than"]),
    ];
    for (document, said) in wrong {
        assert_refused(Method::from_toml(document), said);
    }
}
