//! `stein selftest` on this machine's adapter: every case of the suite is within its bounds, and the command reports
//! differences and failures.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

#[allow(dead_code, unreachable_pub, reason = "every test includes all shared pieces and uses a part of them")]
#[path = "common/process.rs"]
mod process;

use std::collections::BTreeSet;

use process::{Folder, stein};
use serde_json::Value;

fn rows(document: &Value) -> &[Value] {
    document["rows"].as_array().unwrap()
}

fn names<'a>(document: &'a Value, field: &str) -> BTreeSet<&'a str> {
    rows(document).iter().map(|row| row[field].as_str().unwrap()).collect()
}

#[test]
fn stiff_and_extreme_frames_stay_within_their_bounds() {
    let outcome = stein(&["selftest", "--json"]);
    let document = outcome.json();
    let mut failures = Vec::new();
    for row in rows(&document) {
        let figures = row["figures"].as_array().unwrap();
        assert!(!figures.is_empty(), "{row}");
        for figure in figures.iter().filter(|figure| figure["passed"] != true) {
            failures.push(format!("{}, {}: {figure}", row["case"], row["method"]));
        }
        assert_eq!(row["passed"] == true, figures.iter().all(|figure| figure["passed"] == true), "{row}");
    }
    assert!(failures.is_empty(), "{}\n{}", failures.join("\n"), outcome.stderr);
    assert_eq!((outcome.code, &document["passed"]), (0, &Value::Bool(true)), "{}", outcome.stderr);

    // All figures are in the document.
    assert_eq!(names(&document, "method"), BTreeSet::from(["all", "dfc", "dfc-thesis", "gem", "nlm"]));
    assert!(names(&document, "case").len() >= 110, "{} cases", names(&document, "case").len());
    for check in ["door", "finite", "energy", "dark", "error", "reach", "twin", "limit", "bits"] {
        let looked = rows(&document)
            .iter()
            .flat_map(|row| row["figures"].as_array().unwrap())
            .filter(|figure| figure["check"] == check)
            .count();
        assert!(looked >= 9, "{check} was looked at {looked} times");
        assert!(document["worst"].as_array().unwrap().iter().any(|worst| worst["check"] == check), "{check}");
    }
}

#[test]
fn some_cases_are_told_as_a_table_and_compared_with_another_run() {
    let folder = Folder::new();
    let other = folder.path("other.json");
    let arguments = ["selftest", "--case", "a constant image with noise", "--methods", "dfc,gem"];
    let with = |more: &[&str]| stein(&[&arguments[..], more].concat());

    let table = with(&["-v"]).succeeded();
    table.said(&["a constant image with noise", "dfc", "gem", "passed", "worst", "2 of 2 within bounds, 1 cases"]);
    assert!(!table.stdout.contains("dfc-thesis") && !table.stdout.contains("FAILED"), "{}", table.stdout);
    assert_eq!(table.stderr, "", "there is no progress where nobody watches");

    let document = with(&["--json"]).succeeded();
    assert_eq!(rows(&document.json()).len(), 2);
    std::fs::write(&other, &document.stdout).unwrap();
    with(&["--compare", &other]).succeeded().said(&["2 of 2 results are the same to the bit"]);

    // As if another adapter had rounded differently, and had no result for GEM.
    let mut changed = document.json();
    changed["rows"][0]["result"]["checksum"] = "0".into();
    changed["rows"][0]["result"]["mean"] = 1.0.into();
    changed["rows"][1]["method"] = "nlm".into();
    changed["adapter"]["name"] = "another".into();
    std::fs::write(&other, changed.to_string()).unwrap();
    with(&["--compare", &other]).succeeded().said(&[
        "Against another",
        "0 of 1 results are the same to the bit",
        "Missing: ",
        "gem (there)",
        "nlm (here)",
    ]);
    let comparison = &with(&["--compare", &other, "--json"]).succeeded().json()["comparison"];
    assert!(comparison["different"][0]["mean"].as_f64().unwrap() > 0.1, "{comparison}");

    // As if another adapter had values that are not finite, which are null in JSON.
    let mut changed = document.json();
    for field in ["mean", "root_mean_square", "least", "most"] {
        changed["rows"][0]["result"][field] = Value::Null;
    }
    changed["rows"][0]["result"]["checksum"] = "0".into();
    changed["rows"][1]["result"]["error"] = Value::Null;
    std::fs::write(&other, changed.to_string()).unwrap();
    with(&["--compare", &other]).succeeded().said(&["0 of 2 results are the same to the bit", "inf"]);
}

#[test]
fn what_cannot_be_checked_is_refused() {
    let folder = Folder::new();
    let path = folder.path("other.json");
    stein(&["selftest", "--case", "no such situation"]).failed(2, &["there is no such case", "remedy: "]);
    stein(&["selftest", "--methods", "magic"]).failed(2, &["magic", "dfc", "gem"]);
    stein(&["selftest", "--device", "no such adapter"]).failed(4, &["no such adapter"]);
    // A device that fails in a case gives no figure.
    let starved =
        ["selftest", "--case", "a constant image with noise", "--methods", "gem", "--max-memory", "1KiB", "--json"];
    let outcome = stein(&starved);
    outcome.failed(4, &["a constant image with noise, gem: ", "remedy: ", "--max-memory"]);
    assert_eq!(outcome.stdout, "");
    stein(&["selftest", "--compare", &path]).failed(3, &[&path, "cannot be read"]);
    std::fs::write(&path, "{}").unwrap();
    stein(&["selftest", "--compare", &path]).failed(3, &[&path, "was not printed by", "remedy: "]);
    stein(&["selftest", "--help"]).succeeded().said(&[
        "stein selftest --device 1",
        "dark    what the mean colour lacks",
        "Exit codes: 0 all within bounds, 6",
    ]);
}
