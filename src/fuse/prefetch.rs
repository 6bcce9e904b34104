//! Memory asked for before it is needed: a reviewed place with unsafe code. Measured: more than a
//! tenth of `hkust`'s time, because a block's samples and colours lie in ten maps and ten images that
//! no near cache holds.
#![allow(
    unsafe_code,
    reason = "the processor's hint takes a pointer; reviewed here, used by the loops over a block only"
)]

/// Brings the place of `values[at]` near; nothing where there is no such place, or no such hint.
#[inline(always)]
pub(super) fn ahead<T>(values: &[T], at: usize) {
    #[cfg(target_arch = "x86_64")]
    {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        // SAFETY: a hint reads nothing that a program could see, and never faults at any address.
        unsafe { _mm_prefetch::<_MM_HINT_T0>(values.as_ptr().wrapping_add(at).cast()) };
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = (values, at);
}
