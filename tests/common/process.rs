//! The command line, as a process in a folder of its own.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

use std::path::Path;
use std::process::{Command, Stdio};
use stein::frame::RawSignal;

use exr::prelude::*;
use serde_json::Value;
use stein_exr::{BufferSet, BufferSetRequest, NamedLayer};
use tempfile::TempDir;

pub struct Outcome {
    pub code: i32,
    pub stdout: String,
    pub stderr: String,
}

impl Outcome {
    pub fn json(&self) -> Value {
        serde_json::from_str(&self.stdout).unwrap_or_else(|error| panic!("{error}: {}{}", self.stdout, self.stderr))
    }

    /// Checks that the command failed with this exit code and said all of `said`.
    #[track_caller]
    pub fn failed(&self, code: i32, said: &[&str]) {
        assert_eq!(self.code, code, "{}{}", self.stdout, self.stderr);
        for words in said {
            assert!(self.stderr.contains(words), "no '{words}' in: {}", self.stderr);
        }
        assert!(!self.stderr.contains("panicked"), "{}", self.stderr);
    }

    #[track_caller]
    pub fn succeeded(self) -> Self {
        assert_eq!(self.code, 0, "{}{}", self.stdout, self.stderr);
        self
    }

    #[track_caller]
    pub fn said(&self, said: &[&str]) {
        for words in said {
            assert!(self.stdout.contains(words), "no '{words}' in: {}", self.stdout);
        }
    }
}

pub fn command(arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_stein"));
    // Mesa's device selection layer complains on stderr where there is no desktop. No file is left in the home of the
    // user.
    command.args(arguments).env("NODEVICE_SELECT", "1").env("STEIN_CACHE", "").stdin(Stdio::null());
    command
}

pub fn stein(arguments: &[&str]) -> Outcome {
    let output = command(arguments).output().unwrap();
    Outcome {
        code: output.status.code().unwrap(),
        stdout: String::from_utf8(output.stdout).unwrap(),
        stderr: String::from_utf8(output.stderr).unwrap(),
    }
}

pub fn test_image(name: &str) -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../testdata").join(name);
    path.to_str().unwrap().to_owned()
}

/// A folder with a copy of a test image, and paths in it.
pub struct Folder(TempDir);

impl Folder {
    pub fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    pub fn with(name: &str) -> (Self, String) {
        let folder = Self::new();
        let copy = folder.path("render.exr");
        std::fs::copy(test_image(name), &copy).unwrap();
        (folder, copy)
    }

    pub fn path(&self, name: &str) -> String {
        self.0.path().join(name).to_str().unwrap().to_owned()
    }

    /// All files in the folder, including hidden ones.
    pub fn names(&self) -> Vec<String> {
        Self::names_in(&self.path(""))
    }

    /// All files in another folder.
    pub fn names_in(path: &str) -> Vec<String> {
        let entries = std::fs::read_dir(path).unwrap();
        let mut names: Vec<_> = entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }
}

/// Writes only the colour of a file, without some of the layers of its noise: `halfA`, `halfB`, `variance`.
pub fn write_without(parts: &[&str], from: &str, to: &str) {
    let set = BufferSet::read(&BufferSetRequest { input: from.into(), ..Default::default() }).unwrap();
    let RawSignal { mean, half_a, half_b, variance_of_mean } = set.color();
    let rgb = ["R", "G", "B"].map(String::from).to_vec();
    let layers = [("", Some(mean)), ("halfA", half_a), ("halfB", half_b), ("variance", variance_of_mean)].into_iter();
    let layers = layers.filter(|(name, _)| !parts.contains(name));
    let layers: Vec<_> = layers
        .map(|(name, image)| NamedLayer { name: name.into(), channels: rgb.clone(), image: image.unwrap() })
        .collect();
    stein_exr::write_layers(Path::new(to), &layers, &[("samples".into(), "8".into())]).unwrap();
}

pub fn channels(path: &str) -> Vec<(String, FlatSamples)> {
    let image = read_all_flat_layers_from_file(path).unwrap();
    let list = image.layer_data.into_iter().flat_map(|layer| layer.channel_data.list);
    list.map(|channel| (channel.name.to_string(), channel.sample_data)).collect()
}
