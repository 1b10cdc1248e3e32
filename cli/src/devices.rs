//! `stein devices`

use serde::Serialize;
use stein::gpu::{AdapterSummary, DeviceChoice, Gpu};
use stein::text::human_bytes;

use super::Failure;
use super::out::Out;

const EXAMPLE: &str = "\
Example:
  stein devices
  stein denoise render.exr --device 1      uses the adapter with this index
  stein denoise render.exr --device rtx    uses the first adapter with this in its name";

/// List the adapters that can denoise
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLE)]
pub(crate) struct Args {
    /// Print one JSON document
    #[arg(long)]
    pub(crate) json: bool,
}

#[derive(Serialize)]
struct Document<'a> {
    devices: &'a [AdapterSummary],
}

pub(crate) fn run(args: &Args, out: &mut Out) -> Result<(), Failure> {
    let adapters = Gpu::adapters();
    if args.json {
        out.json(&Document { devices: &adapters })?;
    }
    if adapters.is_empty() {
        // Without adapters, opening one returns the error with its remedy.
        return Gpu::open(&DeviceChoice::Auto).map(drop).map_err(Failure::from);
    }
    if !args.json {
        for adapter in &adapters {
            out.say(describe(adapter));
        }
    }
    Ok(())
}

fn describe(adapter: &AdapterSummary) -> String {
    let AdapterSummary { index, name, backend, kind, driver, max_buffer_bytes, max_binding_bytes, timestamps, .. } =
        adapter;
    let timed = if *timestamps { "stages can be timed" } else { "no timestamps: stages cannot be timed" };
    let (buffer, binding) = (human_bytes(*max_buffer_bytes), human_bytes(*max_binding_bytes));
    format!(
        "{index}: {name}\n   {kind}, {backend}, {driver}\
         \n   buffers up to {buffer}, of which a kernel sees up to {binding}; {timed}"
    )
}
