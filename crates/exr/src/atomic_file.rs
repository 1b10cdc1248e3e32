//! Files that appear under their names only when they are complete: they are written beside their destination and then
//! renamed.
//!
//! The process knows its unfinished files, so that a program that a signal ends can remove them first: see [`abandon`].

use std::collections::BTreeSet;
use std::fs::{File, Metadata};
use std::io::{Error, ErrorKind, Result, Write};
use std::ops::{Deref, DerefMut};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

use tempfile::{Builder, NamedTempFile};

/// The unfinished files and folders of this process; `None` once they were abandoned.
static UNFINISHED: Mutex<Option<BTreeSet<PathBuf>>> = Mutex::new(Some(BTreeSet::new()));

fn unfinished() -> MutexGuard<'static, Option<BTreeSet<PathBuf>>> {
    UNFINISHED.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Removes all unfinished files and folders; from now on none can be started or finished. For a program that ends at
/// once, without going back through its work: on a second Ctrl-C, or if the first was not heeded in time. Finished
/// files stay, and nobody ever sees a half-written file.
pub fn abandon() {
    for path in unfinished().take().into_iter().flatten() {
        // Ignores errors: nobody is left to hear of them.
        let _ = if path.is_dir() { std::fs::remove_dir_all(&path) } else { std::fs::remove_file(&path) };
    }
}

/// A temporary file or folder, which is removed when it is dropped or when [`abandon`] is called.
pub struct Aside<T: AsRef<Path>> {
    /// The file or folder; `None` once it is finished.
    made: Option<T>,
    path: PathBuf,
}

impl<T: AsRef<Path>> Aside<T> {
    /// Creates one with `make`.
    ///
    /// # Errors
    /// Errors of `make`, and [`ErrorKind::Interrupted`] once everything was abandoned.
    pub fn make(make: impl FnOnce() -> Result<T>) -> Result<Self> {
        let mut unfinished = unfinished();
        let paths = unfinished.as_mut().ok_or_else(abandoned)?;
        let made = make()?;
        let path = std::path::absolute(made.as_ref())?;
        paths.insert(path.clone());
        Ok(Self { made: Some(made), path })
    }

    /// Lets `place` move it to its destination. [`abandon`] waits meanwhile.
    ///
    /// # Errors
    /// Errors of `place`, and [`ErrorKind::Interrupted`] once everything was abandoned.
    pub fn finish<R>(mut self, place: impl FnOnce(T) -> Result<R>) -> Result<R> {
        let unfinished = unfinished();
        if unfinished.is_none() {
            return Err(abandoned());
        }
        let placed = self.made.take().map_or_else(|| Err(abandoned()), place);
        drop(unfinished);
        placed
    }
}

fn abandoned() -> Error {
    Error::new(ErrorKind::Interrupted, "the process is ending")
}

impl<T: AsRef<Path>> Deref for Aside<T> {
    type Target = T;

    fn deref(&self) -> &T {
        self.made.as_ref().unwrap_or_else(|| unreachable!("it is there until it is finished, which uses it up"))
    }
}

impl<T: AsRef<Path>> DerefMut for Aside<T> {
    fn deref_mut(&mut self) -> &mut T {
        self.made.as_mut().unwrap_or_else(|| unreachable!("it is there until it is finished, which uses it up"))
    }
}

impl<T: AsRef<Path>> Drop for Aside<T> {
    fn drop(&mut self) {
        drop(self.made.take());
        if let Some(paths) = unfinished().as_mut() {
            paths.remove(&self.path);
        }
    }
}

/// Writes a file of these bytes. The file is as readable as the user's other files, or as the file that it replaces. On
/// an error, the earlier file stays and nothing else is left.
///
/// # Errors
/// Errors of the file system, and [`ErrorKind::Interrupted`] once everything was abandoned.
pub fn write(output: &Path, bytes: &[u8]) -> Result<()> {
    let mut builder = Builder::new();
    replace(output, readable(builder.prefix(".stein-").suffix(".part")), |file| file.write_all(bytes))
}

/// Makes the temporary file as readable as the user's other files; temporary files are private by default.
pub fn readable<'a, 'b, 'c>(builder: &'c mut Builder<'a, 'b>) -> &'c mut Builder<'a, 'b> {
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
    builder
}

/// Writes a file beside `output`, has the system store it, and renames it to `output`. The file takes over the access
/// rights of a file that it replaces. On an error, the earlier file stays and nothing else is left.
///
/// # Errors
/// As [`write()`].
pub fn replace(
    output: &Path,
    builder: &mut Builder<'_, '_>,
    write: impl FnOnce(&mut File) -> Result<()>,
) -> Result<()> {
    let folder = match output.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    };
    let mut aside: Aside<NamedTempFile> = Aside::make(|| builder.tempfile_in(folder))?;
    write(aside.as_file_mut())?;
    if let Some(replaced) = output.metadata().ok().filter(Metadata::is_file) {
        inherit(aside.as_file(), &replaced);
    }
    // A remote disk may report only now that it is full. And after a power failure, the name must not exist without the
    // content.
    match aside.as_file().sync_all() {
        // Some file systems do not support this.
        Err(error) if matches!(error.kind(), ErrorKind::Unsupported | ErrorKind::InvalidInput) => {}
        synced => synced?,
    }
    aside.finish(|aside| aside.persist(output).map(drop).map_err(|error| error.error))
}

/// Gives a file or folder the access rights of the one that it replaces: owner and group as far as this process may,
/// and the mode. If the group cannot be kept, its members get no more rights than everybody.
///
/// Ignores errors: file systems without such rights refuse, and have no rights to keep.
pub fn inherit(new: &File, replaced: &Metadata) {
    #[cfg(unix)]
    {
        use std::os::unix::fs::{MetadataExt, PermissionsExt, fchown};
        // Only the superuser may give files away. The new owner needs all rights of the old one.
        let _ = fchown(new, Some(replaced.uid()), None);
        let keeps_group = fchown(new, None, Some(replaced.gid())).is_ok();
        let mode = replaced.mode() & 0o777;
        let of_others = (mode & 0o007) << 3;
        let mode = if keeps_group { mode } else { (mode & 0o707) | (mode & of_others) };
        let _ = new.set_permissions(PermissionsExt::from_mode(mode));
    }
    // On other systems, the folder decides the access rights.
    #[cfg(not(unix))]
    let _ = (new, replaced);
}
