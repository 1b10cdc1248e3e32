//! Whole methods on the GPU. DFC: compared with its float64 twin (`twin`), in the situations of its callers
//! (`behaviour`), over several frames (`time`), and with steps left out (`leave_out`). GEM (`gem`) and NLM (`nlm`): the
//! same for one frame. All methods: spikes (`spikes`), devices with small limits (`limits`), dry runs (`dry`), kernels
//! at a pixel (`kernels`), parameters (`parameters`), and regions beside others (`beside`).

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
mod payload;
mod spikes;
mod time;
mod twin;
