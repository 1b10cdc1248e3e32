//! Files beside the input.

use std::path::{Path, PathBuf};

use super::Files;
use super::main_layer;
use crate::classify::{LayerId, Meaning, Rank};
use crate::file::ExrFile;
use crate::layers::{self};
use crate::layout::{Recognised, RoleName};
use crate::request::BufferSetRequest;
use crate::seeds;
use crate::siblings::{self, Sibling};
use stein::error::{Error, FileCause, Result};

/// Files beside the input.
#[derive(Default)]
pub(super) struct Siblings {
    /// Files with further layers.
    pub(super) files: Vec<PathBuf>,
    /// Other renders of the same frame.
    pub(super) seeds: Vec<PathBuf>,
}

impl Files {
    /// Opens the files beside the input that belong to it. A file that cannot be read is left out and named.
    pub(super) fn open_siblings(&mut self, request: &BufferSetRequest, recognised: &Recognised) -> Siblings {
        let mut siblings = Siblings::default();
        if request.no_siblings {
            return siblings;
        }
        let stem = recognised.stem.as_deref();
        let found = siblings::find(&self.rules.list, &request.input, stem);
        // Files that the user names mean what the user says.
        for sibling in found.into_iter().filter(|sibling| !request.files().any(|named| named == sibling.path)) {
            if self.rules.list[sibling.rule].role == Some(RoleName::Seed) {
                siblings.seeds.push(sibling.path);
                continue;
            }
            match self.open_sibling(&sibling, recognised, &request.input) {
                Ok(()) if siblings.files.contains(&sibling.path) => {}
                Ok(()) => siblings.files.push(sibling.path),
                Err(error) => self.notes.push(format!("not used: {error}")),
            }
        }
        siblings
    }

    pub(super) fn open_sibling(&mut self, sibling: &Sibling, recognised: &Recognised, input: &Path) -> Result<()> {
        let rule = self.rules.list[sibling.rule].clone();
        let has_more = rule.role == Some(RoleName::More);
        let index = match self.list.iter().position(|file| file.path == sibling.path) {
            Some(index) => index,
            None => {
                let encoding = self.encoding(rule.role.and_then(RoleName::feature_name));
                let mut file = ExrFile::read(&sibling.path, encoding)?;
                if let Some(difference) = seeds::other_frame(&self.list[0], &file) {
                    let cause = FileCause::OtherFrame { of: input.to_owned(), reason: difference };
                    return Err(Error::File { path: sibling.path.clone(), cause });
                }
                for join in &recognised.layout.joins {
                    let is_here = |stem: &String| siblings::is(stem, input, recognised.stem.as_deref(), &sibling.path);
                    if join.file.as_ref().is_none_or(is_here) {
                        layers::join(&mut file.layers, join);
                    }
                }
                self.add(file, true);
                let index = self.list.len() - 1;
                self.own_files.push(index);
                if !has_more {
                    // The rules for files alone say what such a file holds.
                    self.classified[index].meanings.iter_mut().for_each(|meaning| *meaning = None);
                    self.classified[index].orphans.clear();
                }
                index
            }
        };
        if has_more {
            return Ok(());
        }
        let of = match &sibling.of {
            None => None,
            Some(path) => match self.list.iter().position(|other| other.path == *path) {
                // The file that this one describes could not be read.
                None => return Ok(()),
                Some(0) => Some(LayerId { file: 0, layer: self.colors(None)?[0].layer }),
                Some(other) => Some(LayerId { file: other, layer: main_layer(&self.list[other])? }),
            },
        };
        let file = &self.list[index];
        let layers: Vec<usize> = if rule.names.is_empty() {
            vec![main_layer(file)?]
        } else {
            let is_named = |layer: &usize| {
                let own = &file.layers[*layer];
                rule.fits_channels(own) && rule.names.iter().any(|name| name.fit(&own.key).is_some())
            };
            (0..file.layers.len()).filter(is_named).collect()
        };
        for layer in layers {
            let meaning = Meaning::new(Rank { rule: sibling.rule, ..Rank::default() }, &rule, String::new(), of);
            self.classified[index].meanings[layer].get_or_insert(meaning);
        }
        Ok(())
    }
}
