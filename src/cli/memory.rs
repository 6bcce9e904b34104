//! How freed memory goes back to the system.
#![allow(
    unsafe_code,
    reason = "the C library's allocator is asked, which no crate of ours wraps"
)]

/// Has every large buffer mapped on its own, so that the system has it back as soon as it is freed.
///
/// glibc raises that limit to the size of what was freed last, up to 32 MiB: clouds of a million points
/// then leave holes that keep a quarter of the peak. Costs page faults; nothing elsewhere.
pub(super) fn return_large_buffers() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    {
        /// `M_MMAP_THRESHOLD` of glibc's `malloc.h`.
        const MMAP_THRESHOLD: i32 = -3;
        const LARGE: i32 = 1 << 18;
        unsafe extern "C" {
            safe fn mallopt(parameter: i32, value: i32) -> i32;
        }
        mallopt(MMAP_THRESHOLD, LARGE);
    }
}
