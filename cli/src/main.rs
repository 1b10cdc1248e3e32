//! `stein`: the command line. Arguments, text and exit codes; one file for each subcommand.

mod adapt;
mod arenas;
mod bench;
mod command;
mod denoise;
mod devices;
mod document;
mod explain;
mod failure;
mod filter;
mod info;
mod inspect;
mod interrupt;
mod kernel;
mod layouts;
mod options;
mod out;
mod output;
mod params;
mod progress;
mod quality;
mod render;
mod report;
mod sample_map;
mod selftest;
mod verdict;

use std::process::ExitCode;

use failure::Failure;
use out::Out;

fn main() -> ExitCode {
    // Before the first thread starts.
    arenas::limit();
    interrupt::listen();
    let mut out = Out::new();
    let result = command::run(&command::parse(), &mut out).and_then(|()| out.finish());
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            // The interrupt caused this failure.
            interrupt::end_if_asked();
            failure.tell();
            failure.exit_code()
        }
    }
}
