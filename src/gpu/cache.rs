//! Compiled pipelines kept on disk, for drivers that leave this to programs.
//!
//! There is one file for each adapter, driver and version of this crate. A file is written under another name and then
//! renamed, so that a reader never sees half a file. If two processes write, the file of the later one remains. A file
//! whose content differs from what was written counts as missing and is replaced. A process that is killed while it
//! writes leaves an unfinished file; a later process removes that file when it opens the cache.

use std::hash::{DefaultHasher, Hash, Hasher};
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::time::{Duration, SystemTime};

use super::device::Gpu;
use super::lock;
use crate::error::{Error, FileCause, Result};

const MAGIC: &[u8; 16] = b"stein pipelines\n";
/// Size of the magic and of a hash of the data behind them, in bytes.
const HEADER_BYTES: usize = MAGIC.len() + size_of::<u64>();

/// Largest size of a file, in bytes. A larger file is started anew: drivers only ever add to the data that they are
/// given.
const MOST_BYTES: u64 = 32 << 20;

/// Number of files kept in the folder: those of the adapters, drivers and versions that were written last.
const MOST_FILES: usize = 8;

const PREFIX: &str = "stein-";
const EXTENSION: &str = "pipelines";

const UNFINISHED_PREFIX: &str = ".stein-";
const UNFINISHED_EXTENSION: &str = "part";

/// Age from which on an unfinished file counts as left behind: writing takes less than a second.
const STALE: Duration = Duration::from_secs(600);

/// Outcome of saving the compiled pipelines.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum SavedPipelines {
    /// No file: no folder was given, or the adapter hands no pipelines out.
    Nowhere,
    /// The file holds them already.
    Unchanged {
        /// Path of the file.
        file: PathBuf,
        /// Size of the file, in bytes.
        bytes: u64,
    },
    /// The file was written.
    Written {
        /// Path of the file.
        file: PathBuf,
        /// Size of the file, in bytes.
        bytes: u64,
    },
}

/// The pipelines of an open device.
pub(super) struct PipelineCache {
    cache: wgpu::PipelineCache,
    file: PathBuf,
    /// Hash of the data in the file, as far as this process knows.
    saved: Mutex<Option<u64>>,
}

impl PipelineCache {
    /// Opens a cache that begins with the data of the file in `folder`. Returns `None` if the driver refuses.
    pub(super) fn open(device: &wgpu::Device, info: &wgpu::AdapterInfo, folder: &Path) -> Option<Self> {
        remove_stale(folder);
        let file = folder.join(file_name(info));
        let data = std::fs::metadata(&file)
            .ok()
            .filter(|found| found.is_file() && found.len() <= MOST_BYTES)
            .and_then(|_| std::fs::read(&file).ok());
        let data = data.as_deref().and_then(unpacked);
        let description = wgpu::PipelineCacheDescriptor { label: Some("stein"), data, fallback: true };
        let scope = device.push_error_scope(wgpu::ErrorFilter::Validation);
        #[expect(unsafe_code, reason = "drivers trust these bytes")]
        // SAFETY: the hash beside the bytes shows that an earlier `get_data` returned them; wgpu and the driver check
        // that they come from this adapter and driver.
        let cache = unsafe { device.create_pipeline_cache(&description) };
        let refused = pollster::block_on(scope.pop()).is_some();
        (!refused).then(|| Self { cache, file, saved: Mutex::new(data.map(hash)) })
    }

    pub(super) fn wgpu(&self) -> &wgpu::PipelineCache {
        &self.cache
    }

    pub(super) fn save(&self) -> Result<SavedPipelines> {
        let Some(data) = self.cache.get_data() else { return Ok(SavedPipelines::Nowhere) };
        let (file, bytes) = (self.file.clone(), (HEADER_BYTES + data.len()) as u64);
        let hash = hash(&data);
        let mut saved = lock(&self.saved);
        if *saved == Some(hash) {
            return Ok(SavedPipelines::Unchanged { file, bytes });
        }
        self.write(&data, hash).map_err(|error| Error::File {
            path: file.clone(),
            cause: FileCause::PipelinesNotKept { reason: error.to_string() },
        })?;
        *saved = Some(hash);
        Ok(SavedPipelines::Written { file, bytes })
    }

    fn write(&self, data: &[u8], hash: u64) -> std::io::Result<()> {
        let folder = self.file.parent().unwrap_or(Path::new("."));
        std::fs::create_dir_all(folder)?;
        // The data has a file of its own until it is complete: other processes may read or write the final file
        // meanwhile.
        let unfinished = folder.join(format!(
            "{UNFINISHED_PREFIX}{}-{:x}.{UNFINISHED_EXTENSION}",
            std::process::id(),
            std::ptr::from_ref(self).addr()
        ));
        let written = std::fs::write(&unfinished, [MAGIC.as_slice(), &hash.to_le_bytes(), data].concat());
        if let Err(error) = written.and_then(|()| std::fs::rename(&unfinished, &self.file)) {
            // Nothing is lost if the unfinished file cannot be removed either.
            let _ = std::fs::remove_file(&unfinished);
            return Err(error);
        }
        remove_oldest(folder);
        Ok(())
    }
}

impl Gpu {
    /// Writes the pipelines compiled so far into the folder of
    /// [`GpuOptions::pipeline_folder`](super::GpuOptions::pipeline_folder), unless the file there holds them already.
    /// This happens by itself when the device is closed. A call also returns the outcome, and the pipelines survive if
    /// the process is killed later.
    ///
    /// # Errors
    /// [`Error::File`] where the file cannot be written.
    pub fn save_pipelines(&self) -> Result<SavedPipelines> {
        self.inner.pipeline_cache.as_ref().map_or(Ok(SavedPipelines::Nowhere), PipelineCache::save)
    }
}

/// Returns the name of the file for an adapter. A driver refuses pipelines that another version of the driver compiled,
/// and each version of this crate compiles other shaders.
fn file_name(info: &wgpu::AdapterInfo) -> String {
    let mut hasher = DefaultHasher::new();
    (&info.name, &info.driver, &info.driver_info, info.backend).hash(&mut hasher);
    format!(
        "{PREFIX}{}-{:04x}-{:04x}-{:016x}.{EXTENSION}",
        env!("CARGO_PKG_VERSION"),
        info.vendor,
        info.device,
        hasher.finish()
    )
}

fn hash(data: &[u8]) -> u64 {
    let mut hasher = DefaultHasher::new();
    data.hash(&mut hasher);
    hasher.finish()
}

/// Returns the data behind the header; `None` if the file does not read back as it was written.
fn unpacked(file: &[u8]) -> Option<&[u8]> {
    let (magic, rest) = file.split_first_chunk()?;
    let (expected, data) = rest.split_first_chunk()?;
    (magic == MAGIC && u64::from_le_bytes(*expected) == hash(data)).then_some(data)
}

/// Removes all files but the `MOST_FILES` that were written last. A folder that cannot be read keeps its files.
fn remove_oldest(folder: &Path) {
    let mut files = dated_files(folder, PREFIX, EXTENSION);
    files.sort();
    for (_, path) in files.iter().rev().skip(MOST_FILES) {
        // Another process may have removed the file already.
        let _ = std::fs::remove_file(path);
    }
}

/// Removes unfinished files of earlier processes. A younger file may belong to a process that is writing it.
fn remove_stale(folder: &Path) {
    for (modified, path) in dated_files(folder, UNFINISHED_PREFIX, UNFINISHED_EXTENSION) {
        // The clock may have been set back; such a file becomes stale later.
        if modified.elapsed().is_ok_and(|age| age >= STALE) {
            // Another process may have removed the file already.
            let _ = std::fs::remove_file(path);
        }
    }
}

/// Returns the files in a folder whose names begin with `prefix` and have this extension, with the times of their last
/// change. A folder that cannot be read has none.
fn dated_files(folder: &Path, prefix: &str, extension: &str) -> Vec<(SystemTime, PathBuf)> {
    let is_ours = |path: &PathBuf| {
        let name = path.file_name().and_then(|name| name.to_str());
        path.extension().is_some_and(|found| found == extension) && name.is_some_and(|name| name.starts_with(prefix))
    };
    let paths = folder.read_dir().into_iter().flatten().flatten().map(|entry| entry.path()).filter(is_ours);
    paths.filter_map(|path| Some((path.metadata().ok()?.modified().ok()?, path))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_not_written_like_this_is_no_file() {
        let data = b"pipelines".as_slice();
        let whole = [MAGIC.as_slice(), &hash(data).to_le_bytes(), data].concat();
        assert_eq!(unpacked(&whole), Some(data));
        for length in 0..whole.len() {
            assert_eq!(unpacked(&whole[..length]), None, "{length}");
        }
        for byte in 0..whole.len() {
            let mut damaged = whole.clone();
            damaged[byte] ^= 1;
            assert_eq!(unpacked(&damaged), None, "{byte}");
        }
    }

    #[test]
    fn the_files_written_last_are_kept_and_nothing_else_is_touched() {
        let folder = tempfile::tempdir().expect("a folder");
        std::fs::write(folder.path().join("other.pipelines"), "").expect("a file");
        for age in 0..MOST_FILES as u64 + 3 {
            let file =
                std::fs::File::create(folder.path().join(format!("{PREFIX}{age:02}.{EXTENSION}"))).expect("a file");
            file.set_modified(SystemTime::UNIX_EPOCH + std::time::Duration::from_secs(1000 - age)).expect("a date");
        }
        remove_oldest(folder.path());
        let mut left: Vec<_> =
            folder.path().read_dir().expect("a folder").map(|entry| entry.expect("an entry").file_name()).collect();
        left.sort();
        let expected = std::iter::once("other.pipelines".to_owned())
            .chain((0..MOST_FILES).map(|age| format!("{PREFIX}{age:02}.{EXTENSION}")));
        assert_eq!(left, expected.map(Into::into).collect::<Vec<std::ffi::OsString>>());
    }
    #[test]
    fn unfinished_files_of_earlier_processes_are_removed() {
        let folder = tempfile::tempdir().expect("a folder");
        let now = SystemTime::now();
        let files = [
            (".stein-1-ab.part", now - 2 * STALE),
            (".stein-2-cd.part", now),
            (".stein-3-ef.part", now + 2 * STALE),
            ("other.part", now - 2 * STALE),
            ("stein-0.pipelines", now - 2 * STALE),
        ];
        for (name, modified) in files {
            let file = std::fs::File::create(folder.path().join(name)).expect("a file");
            file.set_modified(modified).expect("a date");
        }
        remove_stale(folder.path());
        let is_left = files.map(|(name, _)| folder.path().join(name).exists());
        assert_eq!(is_left, [false, true, true, true, true]);
        remove_stale(&folder.path().join("missing"));
    }
}
