//! Whole methods on the GPU. DFC: against its float64 twin (`twin`), as its callers use it (`behaviour`), over several
//! frames (`time`), and with what a frame does not need left out (`leave_out`). GEM (`gem`) and NLM (`nlm`): the same
//! of one frame. What all of them do about spikes (`spikes`) and on devices with small limits (`limits`), and what
//! their parameters say of themselves (`parameters`), and what they do to pixels beside something else (`beside`).

#[allow(dead_code, unreachable_pub, reason = "every test includes all shared pieces and uses a part of them")]
#[path = "../common/mod.rs"]
mod common;
#[allow(dead_code, unreachable_pub, reason = "every test includes all shared pieces and uses a part of them")]
#[path = "../common/frames.rs"]
mod frames;

use stein_reference as reference;
use stein_twin as bridge;

mod behaviour;
mod beside;
mod dry;
mod gem;
mod kernels;
mod leave_out;
mod limits;
mod nlm;
mod parameters;
mod spikes;
mod time;
mod twin;
