//! What the library tells its users to do, where it names its own fields and functions: programs put it into their
//! words.

use std::path::{Path, PathBuf};

/// Of these only callers of the library are told: no program can come to it.
const OF_CALLERS: [&str; 7] = [
    "`GpuFrame::",
    "`Recorder::",
    "`Gpu::record_whole`",
    "`Intermediate::",
    "`wgpu::BufferUsages::",
    "`wgpu::Limits::",
    "`Options::",
];

/// Holds that a program's words for remedies name no item, and say no option twice.
pub(crate) fn name_no_items(told: impl Fn(String) -> String) {
    let remedies = naming_items();
    assert!(remedies.iter().filter(|remedy| remedy.contains("`BufferSetRequest::")).count() >= 6, "{remedies:?}");
    for told in remedies.into_iter().map(told) {
        assert!(!names_item(&told) && !told.contains("with --device with --device"), "{told}");
    }
}

/// Every text in the sources of the library that names one of its items, but for those of callers.
fn naming_items() -> Vec<String> {
    // The programs lie beside it.
    let roots = ["../src", "../crates"].map(|folder| Path::new(env!("CARGO_MANIFEST_DIR")).join(folder));
    let mut texts: Vec<String> = roots
        .iter()
        .flat_map(|root| sources(root))
        .filter(|path| path.extension().is_some_and(|extension| extension == "rs"))
        .flat_map(|path| in_source(&std::fs::read_to_string(path).unwrap_or_default()))
        .collect();
    texts.sort();
    texts.dedup();
    texts.retain(|text| !OF_CALLERS.iter().any(|item| text.contains(item)));
    texts
}

/// Whether a text names an item, as `Type::item`.
fn names_item(text: &str) -> bool {
    text.split("::").skip(1).any(|rest| rest.starts_with(|first: char| first.is_ascii_lowercase()))
}

fn sources(folder: &Path) -> Vec<PathBuf> {
    let paths = std::fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path());
    paths.flat_map(|path| if path.is_dir() { sources(&path) } else { vec![path] }).collect()
}

/// The texts of a source that have an item in backticks.
fn in_source(source: &str) -> Vec<String> {
    let code: Vec<_> = source.lines().filter(|line| !line.trim_start().starts_with("//")).collect();
    let code = code.join("\n");
    let is_named = |at: &usize| {
        code[..*at]
            .trim_end_matches(|letter: char| letter.is_alphanumeric() || letter == '_' || letter == ':')
            .ends_with('`')
    };
    let text = |at: usize| {
        let (first, end) = (code[..at].rfind('"')? + 1, at + code[at..].find('"')?);
        // A line that ends in a backslash goes on with what is not blank.
        let lines: Vec<_> = code[first..end]
            .split("\\\n")
            .enumerate()
            .map(|(place, line)| if place == 0 { line } else { line.trim_start() })
            .collect();
        Some(lines.concat())
    };
    code.match_indices("::").map(|(at, _)| at).filter(is_named).filter_map(text).collect()
}
