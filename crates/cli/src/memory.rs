//! Memory between the steps of a training.

/// Keeps freed memory for the next step.
///
/// A step of 50,000 Gaussians needs some 100 MB for a moment. The C library gives blocks of that size back to the system
/// each time, and the kernel clears them anew: 15 % of all processor time, measured, and 2 % with this.
pub(crate) fn keep() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    {
        const BYTES: libc::c_int = 1 << 30;
        for option in [libc::M_MMAP_THRESHOLD, libc::M_TRIM_THRESHOLD] {
            #[allow(unsafe_code)]
            // SAFETY: two settings of the allocator, made before any other thread runs; a refused one changes nothing.
            unsafe {
                libc::mallopt(option, BYTES);
            }
        }
    }
}
