//! The files of a run, from which it can be resumed.

use std::path::{Path, PathBuf, absolute};
use stein_exr::{MapFile, write_estimate, write_samples};

use serde::Serialize;
use serde_json::{Map, Value};
use stein::method::Intermediate;
use stein::sampling::{Resumed, Samples, SamplingMap};
use stein::text;
use stein::{Estimate, Method};
use stein_exr::{BufferSet, BufferSetRequest};

use super::super::Failure;
use super::super::render::SequenceName;

/// Header attribute of the samples, with the setup as JSON.
const ATTRIBUTE: &str = "stein.adapt";

/// Settings that decide which samples a run draws. A run is resumed only with identical settings.
#[derive(Clone, Copy, Debug, Serialize)]
pub(crate) struct Setup<'a> {
    pub(crate) scene: Option<&'a str>,
    pub(crate) sampler_command: Option<&'a str>,
    pub(crate) size: [u32; 2],
    pub(crate) spp: u32,
    pub(crate) iterations: u32,
    pub(crate) cap: Option<u32>,
    pub(crate) seed: u64,
    pub(crate) sequence: SequenceName,
    pub(crate) parameters: Method,
}

/// Folder with the files of a run.
pub(crate) struct Folder {
    path: PathBuf,
    setup: String,
}

impl Folder {
    /// Creates the folder. Refuses a folder with files of an earlier run, unless `resume` is set, or `overwrite`, which
    /// deletes these files.
    pub(crate) fn open(path: &Path, setup: &Setup<'_>, resume: bool, overwrite: bool) -> Result<Self, Failure> {
        let unusable = |error: std::io::Error| {
            let name = text::path(path);
            Failure::output(format_args!(
                "{name}: {error}\n  remedy: choose another folder with -o, or check that this one may be written to"
            ))
        };
        std::fs::create_dir_all(path).map_err(unusable)?;
        let path = absolute(path).map_err(unusable)?;
        let setup =
            serde_json::to_string(setup).map_err(|error| Failure::output(format_args!("the parameters: {error}")))?;
        let folder = Self { path, setup };
        let earlier = folder.earlier().map_err(unusable)?;
        if overwrite {
            earlier.iter().try_for_each(std::fs::remove_file).map_err(unusable)?;
        } else if let (false, Some(file)) = (resume, earlier.first()) {
            return Err(Failure::output(format_args!(
                "{}: is of an earlier run\
                 \n  remedy: go on with that run with --resume, delete its files with --overwrite, or choose another \
                 folder",
                text::path(file)
            )));
        }
        Ok(folder)
    }

    /// Returns the absolute path of the folder.
    pub(crate) fn path(&self) -> &Path {
        &self.path
    }

    /// Returns all files that are named like the files of a run.
    fn earlier(&self) -> std::io::Result<Vec<PathBuf>> {
        let mut files = Vec::new();
        for entry in std::fs::read_dir(&self.path)? {
            let name = entry?.file_name();
            let stem = name.to_str().and_then(|name| name.strip_suffix(".exr"));
            let parts = stem.and_then(|stem| stem.split_once('_'));
            let ours = |kind: &str, label: &str| {
                ["map", "new", "samples", "denoised"].contains(&kind)
                    && (label == "uniform" || label.bytes().all(|byte| byte.is_ascii_digit()))
            };
            if parts.is_some_and(|(kind, label)| ours(kind, label)) {
                files.push(self.path.join(name));
            }
        }
        files.sort();
        Ok(files)
    }

    fn samples(&self, label: &str) -> PathBuf {
        self.path.join(format!("samples_{label}.exr"))
    }

    /// Returns the last complete iteration; `None` without one. The samples show that an iteration is complete: they
    /// are written after all its other files except the denoised image, which is made from them.
    pub(crate) fn resume(&self, iterations: u32) -> Result<Option<Resumed>, Failure> {
        let found = (1..=iterations)
            .rev()
            .map(|iteration| (iteration, self.samples(&iteration.to_string())))
            .find(|(_, file)| file.exists());
        let Some((iterations, file)) = found else {
            return Ok(None);
        };
        let set = BufferSet::read(&BufferSetRequest { input: file.clone(), no_siblings: true, ..Default::default() })?;
        let then = set.text_attribute(ATTRIBUTE).and_then(|text| serde_json::from_str(&text).ok());
        let now = serde_json::from_str(&self.setup).ok();
        let (Some(then), Some(now)) = (then, now) else {
            let remedy = "choose the folder of a run that was interrupted, or start anew with --overwrite";
            return Err(Failure::input(format_args!(
                "{}: was not written by `stein adapt`\n  remedy: {remedy}",
                text::path(&file)
            )));
        };
        let differences = differences(&then, &now);
        if differences.is_empty() {
            return Ok(Some(Resumed { iterations, samples: set.to_samples()? }));
        }
        Err(Failure::usage(format_args!(
            "{}: the run that is to be resumed had other parameters: {}\
             \n  remedy: give the same, or start anew with --overwrite",
            text::path(&file),
            differences.join(", ")
        )))
    }

    /// Writes the map of the samples that are drawn next.
    pub(crate) fn write_map(&self, label: &str, map: &SamplingMap, drawn: Option<&Samples>) -> Result<(), Failure> {
        let file = MapFile { map: map.clone(), drawn: drawn.map(Samples::counts), windows: None };
        file.write(&self.path.join(format!("map_{label}.exr")), &[]).map_err(Failure::output)
    }

    /// Writes all samples so far and the image that was denoised from them.
    pub(crate) fn write(
        &self,
        label: &str,
        samples: &Samples,
        estimate: &Estimate,
        method: &Method,
    ) -> Result<(), Failure> {
        let file = self.samples(label);
        write_samples(samples, &file, &[(ATTRIBUTE.to_owned(), self.setup.clone())]).map_err(Failure::output)?;
        // The new samples are among `samples` now.
        let _ = std::fs::remove_file(self.path.join(format!("new_{label}.exr")));
        let set = BufferSet::read(&BufferSetRequest { input: file, ..Default::default() })?;
        write_estimate(
            estimate,
            set,
            &self.path.join(format!("denoised_{label}.exr")),
            &[Intermediate::Density],
            method,
        )
        .map(drop)
        .map_err(Failure::output)
    }
}

/// Lists the parameters that differ between the earlier run and this one.
fn differences(then: &Map<String, Value>, now: &Map<String, Value>) -> Vec<String> {
    let names = then.keys().chain(now.keys().filter(|name| !then.contains_key(*name)));
    let text = |value: Option<&Value>| value.map_or_else(|| "nothing".to_owned(), Value::to_string);
    let differing = names.filter(|name| then.get(*name) != now.get(*name));
    let tell = |name: &String| match (then.get(name), now.get(name)) {
        (Some(Value::Object(then)), Some(Value::Object(now))) => differences(then, now).join(", "),
        (then, now) => format!("{name} was {}, now {}", text(then), text(now)),
    };
    differing.map(tell).collect()
}
