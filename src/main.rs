//! `stein`: the command line. Uses the library's public face only.

mod cli;

use std::process::ExitCode;

fn main() -> ExitCode {
    // Before the first thread starts.
    cli::arenas::limit();
    cli::interrupt::listen();
    let mut out = cli::Out::new();
    let result = cli::run(&cli::parse(), &mut out).and_then(|()| out.finish());
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            // What failed did because of that.
            cli::interrupt::end_if_asked();
            failure.tell();
            failure.exit_code()
        }
    }
}
