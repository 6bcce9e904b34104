//! How freed memory goes back to the system.
#![allow(
    unsafe_code,
    reason = "the C library's allocator is asked, which no crate of ours wraps"
)]

/// `M_MMAP_THRESHOLD` of glibc's `malloc.h`.
const MMAP_THRESHOLD: i32 = -3;
/// `M_TRIM_THRESHOLD`.
const TRIM_THRESHOLD: i32 = -1;

/// Sets a parameter of glibc's allocator; elsewhere nothing.
fn set(parameter: i32, value: i32) {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    {
        unsafe extern "C" {
            safe fn mallopt(parameter: i32, value: i32) -> i32;
        }
        mallopt(parameter, value);
    }
    #[cfg(not(all(target_os = "linux", target_env = "gnu")))]
    let _ = (parameter, value);
}

/// Has every large buffer mapped on its own, so that the system has it back as soon as it is freed.
///
/// glibc raises that limit to the size of what was freed last, up to 32 MiB: clouds of a million points
/// then leave holes that keep a quarter of the peak. Costs page faults; nothing elsewhere.
pub(super) fn return_large_buffers() {
    set(MMAP_THRESHOLD, 1 << 18);
}

/// Has freed buffers stay with the program: one view after the other wants the same ones, and pages that
/// are given back are filled with zeros anew, a tenth of the time of a generated image.
pub(super) fn keep_buffers() {
    set(MMAP_THRESHOLD, 1 << 30);
    set(TRIM_THRESHOLD, i32::MAX);
}
