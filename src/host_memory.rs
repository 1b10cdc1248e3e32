//! Memory of the computer: how much of it is left to the process, and large vectors whose allocation returns an error
//! instead of ending the process.

use std::fmt;

use sysinfo::{MemoryRefreshKind, Process, ProcessRefreshKind, ProcessesToUpdate, System};

use crate::error::{DeviceCause, Error};

/// Bytes reserved for allocations that are not planned and cannot return errors: stacks of threads, blocks in a
/// decoder, the driver's compiler.
const RESERVE: u64 = 48 << 20;

/// Limit that bounds the memory of a process.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Bound {
    /// Memory and swap space of the computer.
    Computer,
    /// The control group that the process runs in.
    Container,
    /// The resource limit on the address space.
    AddressSpace,
}

impl fmt::Display for Bound {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Computer => "in this computer",
            Self::Container => "in this container",
            Self::AddressSpace => "of the address space that this process may have (`ulimit -v`)",
        })
    }
}

/// Bytes that the process may still take.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FreeMemory {
    bytes: u64,
    bound: Bound,
}

impl FreeMemory {
    /// Returns the tightest of all limits that the system reports.
    pub fn now() -> Self {
        let computer = System::new().ok().map(|mut system| {
            system.refresh_memory_specifics(MemoryRefreshKind::everything());
            Self { bytes: system.available_memory() + system.free_swap(), bound: Bound::Computer }
        });
        let container = with_own_process(|process| {
            // The system reclaims memory of the container's cached files when it is needed.
            let limits = process.cgroup_limits()?;
            Some(Self {
                bytes: limits.total_memory.saturating_sub(limits.rss) + limits.free_swap,
                bound: Bound::Container,
            })
        });
        // Without a report, only a refused allocation shows that memory is short.
        let unknown = Self { bytes: u64::MAX, bound: Bound::Computer };
        let free = computer.into_iter().chain(container).fold(unknown, Self::tighter);
        let free = Self { bytes: free.bytes.saturating_sub(RESERVE), ..free };
        Self::of_address_space().into_iter().fold(free, Self::tighter)
    }

    /// Returns the free address space of the process. `None` without a limit.
    pub fn of_address_space() -> Option<Self> {
        let most = most_address_space()?;
        let taken = with_own_process(|process| Some(process.virtual_memory()))?;
        Some(Self { bytes: most.saturating_sub(taken + RESERVE), bound: Bound::AddressSpace })
    }

    fn tighter(self, other: Self) -> Self {
        if other.bytes < self.bytes { other } else { self }
    }

    /// Returns the free bytes, without the reserve for unplanned allocations.
    pub fn bytes(self) -> u64 {
        self.bytes
    }

    /// Refuses work that needs more bytes than are free.
    ///
    /// # Errors
    /// [`Shortage`] if `needed` bytes are more than are free.
    pub fn check(self, needed: u64) -> Result<(), Shortage> {
        if needed <= self.bytes { Ok(()) } else { Err(Shortage { needed, free: self }) }
    }
}

/// Returns what `look` finds in this process.
fn with_own_process<T>(look: impl FnOnce(&Process) -> Option<T>) -> Option<T> {
    let (mut system, own) = (System::new().ok()?, sysinfo::get_current_pid().ok()?);
    system.refresh_processes_specifics(
        ProcessesToUpdate::Some(&[own]),
        false,
        ProcessRefreshKind::nothing().with_memory(),
    );
    look(system.process(own)?)
}

/// Returns the resource limit on the address space, in bytes.
#[cfg(unix)]
fn most_address_space() -> Option<u64> {
    rustix::process::getrlimit(rustix::process::Resource::As).current
}

#[cfg(not(unix))]
fn most_address_space() -> Option<u64> {
    None
}

/// More memory is needed than there is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shortage {
    needed: u64,
    free: FreeMemory,
}

impl Shortage {
    /// Makes the shortage of work that needs `needed` bytes.
    pub fn new(needed: u64, free: FreeMemory) -> Self {
        Self { needed, free }
    }

    /// Makes the shortage of a failed allocation of this many bytes.
    pub fn of_allocation(needed: u64) -> Self {
        Self { needed, free: FreeMemory::now() }
    }

    /// Makes the error for work that is named by `what`.
    pub fn error(self, what: &str) -> Error {
        Error::Device(DeviceCause::OutOfHostMemory { what: what.into(), shortage: self })
    }
}

impl fmt::Display for Shortage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mib = |bytes: u64| bytes as f64 / f64::from(1 << 20);
        let Self { needed, free: FreeMemory { bytes, bound } } = self;
        write!(f, "needs {:.0} MiB of memory, but {:.0} MiB are free {bound}", mib(*needed).ceil(), mib(*bytes).floor())
    }
}

/// Makes a vector of `length` times `value`.
///
/// # Errors
/// [`Shortage`] if the allocation fails.
pub fn try_filled<T: Copy>(length: usize, value: T) -> Result<Vec<T>, Shortage> {
    let mut filled = try_with_capacity(length)?;
    filled.resize(length, value);
    Ok(filled)
}

/// Collects the values into a vector of exactly their number.
///
/// # Errors
/// [`Shortage`] if the allocation fails.
pub fn try_collected<T>(values: impl ExactSizeIterator<Item = T>) -> Result<Vec<T>, Shortage> {
    let mut collected = try_with_capacity(values.len())?;
    collected.extend(values);
    Ok(collected)
}

fn try_with_capacity<T>(capacity: usize) -> Result<Vec<T>, Shortage> {
    let mut vector = Vec::new();
    let bytes = (capacity as u64).saturating_mul(size_of::<T>() as u64);
    vector.try_reserve_exact(capacity).map_err(|_| Shortage::of_allocation(bytes))?;
    Ok(vector)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_shortage_names_both_numbers_and_what_bounds_them() {
        let free = FreeMemory { bytes: 10 << 20, bound: Bound::AddressSpace };
        assert!(free.check(10 << 20).is_ok());
        let shortage = free.check((10 << 20) + 1).expect_err("too much");
        let text = shortage.error("denoising").to_string();
        assert!(text.starts_with("denoising needs 11 MiB of memory, but 10 MiB are free"), "{text}");
        assert!(text.contains("ulimit -v") && text.contains("remedy: crop the image"), "{text}");
    }

    #[test]
    fn a_process_has_memory_left_and_no_more_than_the_largest_address() {
        let free = FreeMemory::now().bytes();
        assert!(free > 0 && free < 1 << 48, "{free}");
    }

    #[test]
    fn a_vector_that_cannot_be_is_a_shortage() {
        assert!(try_filled(usize::MAX / 8, 0.0_f32).is_err());
        assert_eq!(try_filled(3, 1.5_f32), Ok(vec![1.5; 3]));
        assert_eq!(try_collected([1, 2].into_iter()), Ok(vec![1, 2]));
    }
}
