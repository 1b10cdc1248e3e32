//! Words and exit codes for what goes wrong in a benchmark.

use stein::text;
use stein_bench::{Error, ExternalCause, FolderCause};

use crate::Failure;

impl From<Error> for Failure {
    fn from(error: Error) -> Self {
        match &error {
            Error::Stein(error) => error.clone().into(),
            Error::Method(error) => Self::usage(error),
            Error::SameName { .. } => Self::usage(format_args!("--external: {error}\n  remedy: choose another name")),
            Error::ReferenceCount { .. } => {
                Self::usage(format_args!("{error}\n  remedy: give --ref once for each input, or not at all"))
            }
            Error::ReferenceOfFolder { folder } => Self::usage(format_args!(
                "{}: --ref belongs to a file, and this is a folder\n  remedy: leave --ref out, the references of a folder are found by their names, or give its files",
                text::path(folder)
            )),
            Error::NoSets { .. } => Self::input(format_args!("{error}\n  remedy: name a folder with renders")),
            Error::Unreadable { .. } => Self::input(format_args!("{error}\n  remedy: check the path")),
            Error::UnreadableFolder { .. } => {
                Self::input(format_args!("{error}\n  remedy: check that the folder may be read"))
            }
            Error::Path { .. } | Error::WrittenByStein { .. } => Self::input(error.to_string()),
            Error::NoHalves { file } => Self::input(format_args!(
                "{}: --noise halves: it has no halves that can be used\n  remedy: leave halves out of --noise, or give the set's two halves",
                text::path(file)
            )),
            Error::NothingMeasured => Self::input(format_args!(
                "{error}\n  remedy: name sets that can be denoised; `stein info` tells what is missing"
            )),
            Error::External { name, cause } => external(cause).at(format_args!("--external {name}")),
            Error::Log { .. } => Self::output(format_args!("{error}\n  remedy: check the folder for temporary files")),
            Error::Folder { cause, .. } => {
                let remedy = match cause {
                    FolderCause::Unusable(_) => {
                        "choose another folder with -o, or check that this one may be written to"
                    }
                    FolderCause::NoReport => "choose another folder with -o; only reports are replaced",
                    FolderCause::Changed => "choose another folder with -o",
                    FolderCause::Unwritable(_) => "check that there is space, and choose a folder with -o",
                };
                Self::output(format_args!("{error}\n  remedy: {remedy}"))
            }
            Error::Part { .. } => Self::output(error.to_string()),
            Error::Cancelled => Self::other("interrupted"),
            error => Self::other(error.to_string()),
        }
    }
}

fn external(cause: &ExternalCause) -> Failure {
    match cause {
        ExternalCause::Program { .. } => {
            Failure::input(format_args!("{cause}\n  remedy: run the command by itself, as it stands here"))
        }
        ExternalCause::Unreadable(error) => Failure::input(error),
        ExternalCause::OtherExtent { .. } => {
            Failure::input(format_args!("{cause}\n  remedy: let it keep the size of its input"))
        }
    }
}
