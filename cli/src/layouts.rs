//! `stein layouts`

use serde::Serialize;
use stein_exr::Layout;

use super::out::table;
use super::{Failure, Out};

const EXAMPLE: &str = "\
Example:
  stein layouts
  stein layouts --show pbrt > my.toml      writes one to start from
  stein denoise render.exr --layout my.toml

A layout is a TOML file: what the layers of a renderer's files are called, and what they hold. docs/layouts.md explains \
it.";

/// List the layouts of files that are known, or print one
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLE)]
pub(crate) struct Args {
    /// Print the TOML document of one layout: by its name, or from a TOML file, which is checked
    #[arg(long, value_name = "NAME|FILE")]
    show: Option<String>,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

#[derive(Serialize)]
struct Document<'a> {
    layouts: Vec<Described<'a>>,
}

#[derive(Serialize)]
struct Described<'a> {
    name: &'a str,
    title: &'a str,
    /// The TOML document, if it is asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    document: Option<&'a str>,
}

pub(crate) fn run(args: &Args, out: &mut Out) -> Result<(), Failure> {
    let shown = args.show.as_deref().map(Layout::named).transpose()?;
    if args.json {
        let described = |layout| Described::new(layout, shown.is_some());
        let layouts = shown.as_ref().map_or(Layout::built_in(), std::slice::from_ref);
        return out.json(&Document { layouts: layouts.iter().map(described).collect() });
    }
    match &shown {
        Some(layout) => out.line(layout.document()),
        None => {
            let row = |layout: &Layout| vec![layout.name().to_owned(), layout.title().to_owned()];
            out.say(table(&Layout::built_in().iter().map(row).collect::<Vec<_>>(), 2));
        }
    }
    Ok(())
}

impl<'a> Described<'a> {
    fn new(layout: &'a Layout, with_document: bool) -> Self {
        Self { name: layout.name(), title: layout.title(), document: with_document.then(|| layout.document()) }
    }
}
