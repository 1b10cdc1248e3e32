//! Lists the layouts in `layouts/`, so that a new one is a new file and nothing else.

use std::fmt::Write;
use std::path::Path;
use std::{env, fs};

fn main() {
    let folder = Path::new(&env::var("CARGO_MANIFEST_DIR").expect("cargo names the folder")).join("layouts");
    println!("cargo:rerun-if-changed={}", folder.display());
    let entries = fs::read_dir(&folder).expect("the folder of layouts can be read");
    let mut files: Vec<_> = entries.map(|entry| entry.expect("an entry of the folder can be read").path()).collect();
    files.retain(|file| file.extension().is_some_and(|extension| extension == "toml"));
    files.sort();
    let mut list = String::from("&[\n");
    for file in files {
        let name = file.file_stem().expect("a layout has a name").to_string_lossy().into_owned();
        writeln!(list, "    ({name:?}, include_str!({:?})),", file.display().to_string()).expect("a text grows");
    }
    list += "]\n";
    let out = Path::new(&env::var("OUT_DIR").expect("cargo names the folder")).join("layouts.rs");
    fs::write(out, list).expect("the list can be written");
}
