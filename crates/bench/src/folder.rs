//! The folder of a report.

use std::fs::File;
use std::path::{Path, PathBuf};

use stein_exr::atomic_file::{self, Aside};

use crate::compare::read_document;
use crate::run::Measured;
use crate::{Error, Result, csv_file, page};

/// Files of a report.
const FILES: [&str; 3] = ["results.json", "results.csv", "index.html"];

/// The reason why a folder cannot take a report.
#[derive(Debug, thiserror::Error)]
pub enum FolderCause {
    /// The folder, or the folder around it, cannot be used.
    #[error("{0}")]
    Unusable(std::io::Error),
    /// There is something else than a report.
    #[error("is there already, and is no report of `stein bench`")]
    NoReport,
    /// Something else than a report appeared while the run measured.
    #[error("something else than a report was put there meanwhile")]
    Changed,
    /// The report cannot be written.
    #[error("cannot be written: {0}")]
    Unwritable(std::io::Error),
}

/// Folder of a report.
pub struct Folder {
    path: PathBuf,
}

impl Folder {
    /// Checks before anything is measured that `path` is a report, an empty folder, or does not exist.
    ///
    /// # Errors
    /// [`Error::Folder`] if the report could not be written.
    pub fn check(path: &Path) -> Result<Self> {
        let failed = |cause| Error::Folder { folder: path.to_owned(), cause };
        let unusable = |error| failed(FolderCause::Unusable(error));
        let absolute = std::path::absolute(path).map_err(unusable)?;
        if path.exists() && !may_be_replaced(path).map_err(unusable)? {
            return Err(failed(FolderCause::NoReport));
        }
        let folder = Self { path: absolute };
        // Tests that a temporary folder can be created; that folder is removed at once.
        folder.aside().map_err(unusable)?;
        Ok(folder)
    }

    /// Returns the path of the page.
    pub fn index(&self) -> PathBuf {
        self.path.join("index.html")
    }

    /// Creates a temporary folder beside the report's folder, so that a finished report only has to be renamed.
    fn aside(&self) -> std::io::Result<Aside<tempfile::TempDir>> {
        let mut builder = tempfile::Builder::new();
        builder.prefix(".stein-report-");
        // Temporary folders are private by default; a report is as readable as the user's other files.
        #[cfg(unix)]
        builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o777));
        Aside::make(|| builder.tempdir_in(self.path.parent().unwrap_or(Path::new("/"))))
    }

    /// Gives a new report and its files the access rights of the report and the files that they replace.
    fn hand_down_rights(&self, new: &Path) -> std::io::Result<()> {
        for file in FILES {
            // An empty folder has no files to replace.
            if let Ok(replaced) = self.path.join(file).metadata() {
                atomic_file::inherit(&File::open(new.join(file))?, &replaced);
            }
        }
        // A folder can be opened on systems where it has access rights of its own.
        if cfg!(unix) {
            atomic_file::inherit(&File::open(new)?, &self.path.metadata()?);
        }
        Ok(())
    }

    /// Writes the report of a run; it replaces the earlier report or the empty folder.
    ///
    /// # Errors
    /// [`Error::Folder`] if the folder cannot be written; [`Error::Part`] and [`Error::Stein`] if a part of the report
    /// cannot be made.
    pub fn write(&self, Measured { document, gallery }: &Measured) -> Result<()> {
        let json = serde_json::to_string_pretty(document)
            .map_err(|error| Error::Part { part: "results.json", reason: error.to_string() })?;
        self.write_files([json.as_bytes(), &csv_file::csv(document)?, page::page(document, gallery)?.as_bytes()])
    }

    /// Writes the files, in the order of [`FILES`].
    fn write_files(&self, contents: [&[u8]; 3]) -> Result<()> {
        let because = |cause| Error::Folder { folder: self.path.clone(), cause };
        let failed = |error| because(FolderCause::Unwritable(error));
        let new = self.aside().map_err(failed)?;
        for (file, content) in FILES.iter().zip(contents) {
            std::fs::write(new.path().join(file), content).map_err(failed)?;
        }
        // The folder may have changed since [`Self::check`].
        if self.path.exists() {
            if !may_be_replaced(&self.path).map_err(failed)? {
                return Err(because(FolderCause::Changed));
            }
            let old = self.aside().map_err(failed)?;
            let old_report = old.path().join("old");
            let placed = new.finish(|new| {
                self.hand_down_rights(new.path())?;
                std::fs::rename(&self.path, &old_report)?;
                let placed = std::fs::rename(new.path(), &self.path);
                match &placed {
                    // The folder has its final name now and must not be removed as a temporary one.
                    Ok(()) => drop(new.keep()),
                    Err(_) => std::fs::rename(&old_report, &self.path)?,
                }
                placed
            });
            return placed.map_err(failed);
        }
        new.finish(|new| std::fs::rename(new.path(), &self.path).map(|()| drop(new.keep()))).map_err(failed)
    }
}

/// Whether the path is an empty folder, or a report and nothing else.
fn may_be_replaced(path: &Path) -> std::io::Result<bool> {
    if !path.is_dir() {
        return Ok(false);
    }
    let mut names = Vec::new();
    for entry in std::fs::read_dir(path)? {
        names.push(entry?.file_name());
    }
    Ok(names.is_empty()
        || (names.iter().all(|name| FILES.iter().any(|file| name == file)) && read_document(path).is_ok()))
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]
mod tests {
    use super::*;
    use crate::VERSION;

    #[test]
    fn only_reports_are_replaced() {
        let parent = tempfile::tempdir().unwrap();
        let path = parent.path().join("report");
        let folder = Folder::check(&path).unwrap();
        let document = |date: &str| {
            let adapter =
                serde_json::json!({ "name": "", "backend": "", "kind": "", "driver": "", "timestamps": true });
            let document = serde_json::json!({
                "schema": "stein.bench", "version": VERSION, "stein": "0", "date": date, "arguments": [], "adapter": adapter, "repeats": 1,
                "configurations": [], "sets": [], "rows": [], "notes": [],
            });
            document.to_string()
        };
        for date in ["first", "second"] {
            folder.write_files([document(date).as_bytes(), b"csv", b"html"]).unwrap();
            assert_eq!(read_document(&path).unwrap().date, date);
            assert_eq!(std::fs::read(path.join("index.html")).unwrap(), b"html");
        }
        assert_eq!(std::fs::read_dir(parent.path()).unwrap().count(), 1, "nothing is left beside it");
        Folder::check(&path).unwrap();

        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt;
            let mode = |path: &Path| std::fs::metadata(path).unwrap().permissions().mode() & 0o777;
            let page = path.join("index.html");
            std::fs::set_permissions(&page, PermissionsExt::from_mode(0o600)).unwrap();
            std::fs::set_permissions(&path, PermissionsExt::from_mode(0o750)).unwrap();
            folder.write_files([document("third").as_bytes(), b"csv", b"html"]).unwrap();
            assert_eq!((mode(&path), mode(&page)), (0o750, 0o600), "a report is not shown to more people than before");
        }

        std::fs::write(path.join("thoughts.txt"), "mine").unwrap();
        assert!(Folder::check(&path).is_err() && folder.write_files([b"", b"", b""]).is_err());
        assert_eq!(std::fs::read(path.join("thoughts.txt")).unwrap(), b"mine");
        std::fs::remove_file(path.join("thoughts.txt")).unwrap();
        std::fs::write(path.join("results.json"), "{}").unwrap();
        assert!(Folder::check(&path).is_err(), "of another program");
        assert!(Folder::check(&path.join("results.json")).is_err(), "a file");
        assert!(Folder::check(&parent.path().join("no/such")).is_err());
        let empty = parent.path().join("empty");
        std::fs::create_dir(&empty).unwrap();
        Folder::check(&empty).unwrap().write_files([document("").as_bytes(), b"", b""]).unwrap();
    }
}
