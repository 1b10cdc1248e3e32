//! `stein params`

use std::fmt::Write;
use std::path::PathBuf;

use stein::Method;
use stein::parameters::{Kind, Parameter, Value};
use stein::text;

use super::filter::{Chosen, Filter};
use super::out::table;
use super::{Failure, Out};

const EXAMPLE: &str = "\
The file is TOML: the names of method and preset, and every parameter with its meaning and range. Other commands read \
it with `--params FILE`. Parameters that the file leaves out keep the value of the preset, so one line may be enough.

Examples:
  stein params                                        prints the parameters of dfc
  stein params --method nlm --radius 7 -o nlm.toml
  stein denoise render.exr --params nlm.toml
  stein params --params nlm.toml --list               lists the values of the file, and the ranges

Exit codes: 0 done, 2 wrong usage, 3 a file of parameters cannot be used, 5 the output cannot be written.";

/// Write the parameters of a method to a file, or list them
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLE)]
pub(crate) struct Args {
    /// List name, value, default, range and meaning, not as TOML
    #[arg(long)]
    list: bool,
    /// Print a Markdown page with the parameters of all methods
    #[arg(long, exclusive = true)]
    markdown: bool,
    /// Where to write [default: standard output]
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    #[command(flatten)]
    filter: Filter,
}

pub(crate) fn run(args: &Args, out: &mut Out) -> Result<(), Failure> {
    let Chosen { method, preset } = args.filter.chosen()?;
    let text = match (args.markdown, args.list) {
        (true, _) => page(),
        (_, true) => list(&method),
        _ => method.to_toml(preset),
    };
    let Some(file) = &args.output else {
        out.say(text);
        return Ok(());
    };
    stein_exr::atomic_file::write(file, text.as_bytes()).map_err(|error| {
        let name = text::path(file);
        Failure::output(format_args!(
            "{name}: cannot be written: {error}\
             \n  remedy: check that the folder exists, may be written to and has space left"
        ))
    })
}

/// Formats a row for each parameter.
fn list(method: &Method) -> String {
    let mut rows = vec![["parameter", "value", "default", "thesis", "range", "meaning"].map(str::to_owned).to_vec()];
    for parameter in method.parameters() {
        let [value, default, thesis] = [&parameter.value, &parameter.default, &parameter.thesis].map(shown);
        let meaning = parameter.summary().to_owned();
        rows.push(vec![parameter.name.clone(), value, default, thesis, range(&parameter), meaning]);
    }
    table(&rows, 6)
}

/// Formats a value; empty if the group is left out.
fn shown(value: &Option<Value>) -> String {
    value.as_ref().map_or_else(String::new, Value::to_string)
}

/// Formats the range of a parameter; empty for a flag or a group, whose range is obvious.
fn range(parameter: &Parameter) -> String {
    match parameter.kind {
        Kind::Flag | Kind::Group => String::new(),
        _ => parameter.range(),
    }
}

/// Formats all parameters of all methods.
fn page() -> String {
    let mut page = String::from(
        "# Parameters\n\n`stein params` writes those of a method into a TOML file, with `--list` it lists them, and \
         with `--markdown` it has written this page. Where a cell is empty, the preset leaves out the group that the \
         parameter is in.\n",
    );
    for method in Method::all() {
        // Writing to a string cannot fail.
        let _ = writeln!(
            page,
            "\n## {}\n\n| parameter | default | thesis | range | meaning |\n| --- | --- | --- | --- | --- |",
            method.name()
        );
        let parameters = method.parameters();
        for parameter in &parameters {
            let [default, thesis] = [&parameter.default, &parameter.thesis].map(shown);
            let meaning = cell(&parameter.documentation);
            let _ =
                writeln!(page, "| `{}` | {default} | {thesis} | {} | {meaning} |", parameter.name, range(parameter));
        }
        for parameter in &parameters {
            let (Kind::Choice { options } | Kind::Set { options }) = &parameter.kind else { continue };
            let _ = writeln!(page, "\n| `{}` | meaning |\n| --- | --- |", parameter.name);
            for option in options {
                let _ = writeln!(page, "| {} | {} |", option.name, cell(&option.documentation));
            }
        }
    }
    page
}

/// Formats text as a cell of a table.
fn cell(text: &str) -> String {
    text.replace("\n\n", "<br>").replace('|', "\\|")
}
