//! The address space that the allocator reserves.

/// Where the address space is limited (`ulimit -v`), keeps the allocator from reserving 64 MB of it and more for each
/// thread, which leaves nothing to the images. To be called before a thread starts.
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
