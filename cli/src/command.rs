//! The arguments, and the subcommand that they choose.

use clap::{CommandFactory, Parser, Subcommand};

use crate::failure::Failure;
use crate::out::Out;
use crate::{adapt, bench, denoise, devices, info, kernel, layouts, params, render, sample_map, selftest};

const EXIT_CODES: &str = "\
Exit codes: 0 done, 2 wrong usage, 3 an input file or layer cannot be used, 4 no device or a device failed, 5 the \
output cannot be written, 6 the self test found a figure out of bounds, 1 anything else. For a shot, 3 means that \
some frames could not be used: they are named, and the others are written.

Paths: a path that exists is taken as that file, whatever its characters. In other paths `#` or `%04d` stands for the \
number of a frame, and `::` separates a file from its layer. --literal takes every path as it is. Write a name that \
begins with a dash as ./-name.

Environment:
  STEIN_CACHE  folder for compiled shaders, kept between runs if the driver hands them out; empty: keep none \
[default: `stein` among the user's caches]

Example:
  stein info render.exr                    says what is in it, and how to denoise it
  stein denoise render.exr                 writes render.denoised.exr
  stein denoise --help                     explains all options";

/// Denoises Monte Carlo renderings on the GPU and estimates the error of the result.
#[derive(Debug, Parser)]
#[command(name = "stein", version, after_help = EXIT_CODES, arg_required_else_help = true)]
pub(crate) struct Cli {
    #[command(subcommand)]
    command: Option<Command>,
    /// List the adapters, like `stein devices`
    #[arg(long, exclusive = true)]
    list_devices: bool,
}

#[derive(Debug, Subcommand)]
enum Command {
    Denoise(denoise::Args),
    Info(info::Args),
    Layouts(layouts::Args),
    Kernel(kernel::Args),
    SampleMap(sample_map::Args),
    Adapt(Box<adapt::Args>),
    Params(Box<params::Args>),
    Render(render::Args),
    Bench(bench::Args),
    Devices(devices::Args),
    Selftest(selftest::Args),
}

/// Parses the arguments. Ends the process if they are wrong or ask for help.
pub(crate) fn parse() -> Cli {
    Cli::parse()
}

/// Runs the chosen subcommand.
pub(crate) fn run(cli: &Cli, out: &mut Out) -> Result<(), Failure> {
    match &cli.command {
        Some(Command::Denoise(args)) if args.device.list_devices => {
            devices::run(&devices::Args { json: args.json }, out)
        }
        Some(Command::Bench(args)) if args.device.list_devices => devices::run(&devices::Args { json: args.json }, out),
        Some(Command::Kernel(args)) if args.device.list_devices => {
            devices::run(&devices::Args { json: args.json }, out)
        }
        Some(Command::SampleMap(args)) if args.device.list_devices => {
            devices::run(&devices::Args { json: args.json }, out)
        }
        Some(Command::Adapt(args)) if args.device.list_devices => devices::run(&devices::Args { json: args.json }, out),
        Some(Command::Selftest(args)) if args.device.list_devices => {
            devices::run(&devices::Args { json: args.json }, out)
        }
        Some(Command::Denoise(args)) => denoise::run(args, out),
        Some(Command::Kernel(args)) => kernel::run(args, out),
        Some(Command::SampleMap(args)) => sample_map::run(args, out),
        Some(Command::Adapt(args)) => adapt::run(args, out),
        Some(Command::Params(args)) => params::run(args, out),
        Some(Command::Render(args)) => render::run(args, out),
        Some(Command::Bench(args)) => bench::run(args, out),
        Some(Command::Info(args)) => info::run(args, out),
        Some(Command::Layouts(args)) => layouts::run(args, out),
        Some(Command::Devices(args)) => devices::run(args, out),
        Some(Command::Selftest(args)) => selftest::run(args, out),
        None if cli.list_devices => devices::run(&devices::Args { json: false }, out),
        None => {
            out.say(Cli::command().render_help());
            Ok(())
        }
    }
}
