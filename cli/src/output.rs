//! The path of an output, and its checks.

use std::ffi::OsString;
use std::path::{Path, PathBuf};

use stein::text;
use stein_exr::atomic_file::Aside;
use stein_exr::picture_file::Format;
use stein_exr::{BufferSet, same_file};

use super::Failure;

/// Returns the requested path, or `IN` with `.denoised` before its extension. If the requested path is a folder, the
/// file in it gets that name.
pub(crate) fn choose(input: &Path, named: Option<&Path>) -> PathBuf {
    let mut name = input.file_stem().map_or_else(|| OsString::from("image"), OsString::from);
    name.push(".denoised.exr");
    match named {
        Some(folder) if folder.is_dir() => folder.join(name),
        Some(file) => file.to_owned(),
        None => input.with_file_name(name),
    }
}

/// Creates a folder for temporary files.
pub(crate) fn scratch() -> Result<Aside<tempfile::TempDir>, Failure> {
    Aside::make(tempfile::tempdir).map_err(|error| {
        Failure::output(format_args!(
            "no folder for temporary files: {error}\n  remedy: let TMPDIR name a folder that may be written to"
        ))
    })
}

/// Formats of a denoised picture. PFM and PNG hold its colour alone.
pub(crate) const PICTURE: &[Format] = &[Format::OpenExr, Format::Pfm, Format::Png];

/// Reports before the work what would fail after it. The output has one of these formats.
pub(crate) fn check<'a>(
    output: &Path,
    formats: &[Format],
    others: impl Iterator<Item = &'a Path>,
    no_clobber: bool,
    dry_run: bool,
) -> Result<(), Failure> {
    check_name(output, formats, others.filter(|other| same_file(output, other)))?;
    if no_clobber && output.exists() {
        let name = text::path(output);
        return Err(Failure::output(format_args!(
            "{name}: exists already\n  remedy: choose another name with -o, or leave --no-clobber out"
        )));
    }
    check_folder(output, dry_run)
}

/// Checks that the output is a file of a known format and replaces no file that is read. `same_files` are the files to
/// read that are the same file as the output.
pub(crate) fn check_name<'a>(
    output: &Path,
    formats: &[Format],
    mut same_files: impl Iterator<Item = &'a Path>,
) -> Result<(), Failure> {
    let name = text::path(output);
    if !Format::from_extension(output).is_some_and(|format| formats.contains(&format)) {
        let (kinds, colour_alone) = match formats {
            [Format::OpenExr] => ("OpenEXR", ""),
            _ => ("OpenEXR, PFM or PNG", ", or in .pfm or .png for the colour alone"),
        };
        return Err(Failure::usage(format_args!(
            "{name}: the output is an {kinds} file\n  remedy: give it a name that ends in .exr{colour_alone}"
        )));
    }
    same_files.next().map_or(Ok(()), |other| Err(also_read(output, other)))
}

fn also_read(output: &Path, other: &Path) -> Failure {
    Failure::output(format_args!(
        "{}: is also read, as {}, and would be replaced\n  remedy: choose another name with -o",
        text::path(output),
        text::path(other)
    ))
}

/// Refuses an output that would replace a file that belongs to the input, such as one that was found beside it. The
/// input itself may be replaced.
pub(crate) fn check_not_read(output: &Path, set: &BufferSet) -> Result<(), Failure> {
    let is_other = |file: &&Path| !same_file(file, set.input()) && same_file(file, output);
    set.files().find(is_other).map_or(Ok(()), |other| Err(also_read(output, other)))
}

/// Checks that the folder of the output can be written to.
pub(crate) fn check_folder(output: &Path, dry_run: bool) -> Result<(), Failure> {
    let name = text::path(output);
    let folder = match output.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    };
    let trouble = match folder.metadata() {
        Err(error) => Some(error),
        // The temporary file is removed at once.
        Ok(_) if !dry_run => tempfile::tempfile_in(folder).err(),
        Ok(_) => None,
    };
    match trouble {
        None => Ok(()),
        Some(error) => Err(Failure::output(format_args!(
            "{name}: cannot be written: {error}\
             \n  remedy: check that the folder exists, may be written to and has space left"
        ))),
    }
}
