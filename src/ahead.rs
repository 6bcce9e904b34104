//! Asking for memory ahead of its turn: where rows of many maps, or triangles in no order, are read side by
//! side, no near cache holds what comes next.
#![allow(
    unsafe_code,
    reason = "a prefetch takes a pointer; measured: a tenth of a view of 1 to 5 million triangles, and of \
              fusing"
)]

/// Bytes of a cache line.
const LINE: usize = 64;

/// Has all cache lines of a slice fetched.
#[inline(always)]
pub(crate) fn prefetch_all<T>(values: &[T]) {
    for at in (0..values.len()).step_by((LINE / size_of::<T>().max(1)).max(1)) {
        prefetch(values, at);
    }
}

/// Has the processor fetch the cache line of `values[at]`, if it knows how to be asked; nothing comes of
/// places beyond the slice.
#[inline(always)]
pub(crate) fn prefetch<T>(values: &[T], at: usize) {
    #[cfg(target_arch = "x86_64")]
    {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        // SAFETY: part of every x86-64; a hint reads nothing that a program could see, and never faults at
        // any address.
        unsafe { _mm_prefetch::<_MM_HINT_T0>(values.as_ptr().wrapping_add(at).cast()) };
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = (values, at);
}
