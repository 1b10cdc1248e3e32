//! The address space that the allocator reserves.

/// Keeps the allocator from reserving 64 MB and more of address space for each thread if the address space is limited
/// (`ulimit -v`): the reservations would leave nothing for the images. Must be called before a thread starts.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
pub(crate) fn limit() {
    if rustix::process::getrlimit(rustix::process::Resource::As).current.is_some() {
        #[expect(unsafe_code, reason = "the allocator has no other interface")]
        // SAFETY: no other thread runs yet.
        unsafe {
            libc::mallopt(libc::M_ARENA_MAX, 1);
        }
    }
}

#[cfg(not(all(target_os = "linux", target_env = "gnu")))]
pub(crate) fn limit() {}
