//! Asking for memory ahead of its turn: where rows of many maps, or triangles in no order, are read side by
//! side, no near cache holds what comes next. And writing past the caches what is not read again soon.
#![allow(
    unsafe_code,
    reason = "a prefetch takes a pointer; measured: a tenth of a view of 1 to 5 million triangles, and of \
              fusing. So does a store past the caches; measured: a fifteenth of the exact maps of \
              0.2 million triangles. So does a wish for large pages; measured: a twentieth of the same, at least"
)]

use std::marker::PhantomData;
use std::mem::MaybeUninit;

/// Bytes of a cache line.
const LINE: usize = 64;

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

/// Asks the system to put memory that nobody has touched yet into pages of 2 MiB, if it knows how to be asked:
/// what is written all over then needs fewer entries of the tables of pages.
pub(crate) fn in_large_pages<T>(room: &mut [MaybeUninit<T>]) {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    {
        /// A multiple of every size of small pages.
        const PAGE: usize = 1 << 16;
        /// `MADV_HUGEPAGE` of `sys/mman.h`.
        const HUGE: i32 = 14;
        unsafe extern "C" {
            fn madvise(at: *mut std::ffi::c_void, size: usize, advice: i32) -> i32;
        }
        let start = room.as_mut_ptr().cast::<u8>();
        let skipped = start.addr().next_multiple_of(PAGE) - start.addr();
        let size = size_of_val(room).saturating_sub(skipped) / PAGE * PAGE;
        if size > 0 {
            // SAFETY: whole pages of the slice; what is asked for changes no byte, and may be refused.
            unsafe { madvise(start.add(skipped).cast(), size, HUGE) };
        }
    }
    #[cfg(not(all(target_os = "linux", target_env = "gnu")))]
    let _ = room;
}

/// Words of a cache line.
pub(crate) const WORDS: usize = LINE / 4;

/// Four bytes of which each pattern is a value.
pub(crate) trait Word: Copy {}
impl Word for f32 {}
impl Word for u32 {}

/// How many words lie between the last border of cache lines and `words[at]`.
#[inline(always)]
pub(crate) fn past_border<T: Word>(words: &[T], at: usize) -> usize {
    words.as_ptr().wrapping_add(at).addr() / size_of::<T>() % WORDS
}

/// Writes past the caches. Nobody may look at what was written before this is dropped, which waits for the
/// writes to be done.
#[derive(Debug)]
pub(crate) struct Stream {
    /// The thread that writes has to be the one that waits.
    _stays: PhantomData<*const ()>,
    /// Whether half a cache line can be written at a time.
    #[cfg(target_arch = "x86_64")]
    wide: bool,
}

impl Stream {
    pub(crate) fn new() -> Self {
        Self {
            _stays: PhantomData,
            #[cfg(target_arch = "x86_64")]
            wide: is_x86_feature_detected!("avx"),
        }
    }

    /// Copies words, past the caches where whole cache lines are written.
    #[inline(always)]
    pub(crate) fn copy<T: Word>(&self, from: &[T], to: &mut [T]) {
        const { assert!(size_of::<T>() * WORDS == LINE) };
        #[cfg(target_arch = "x86_64")]
        if past_border(to, 0) == 0 && to.len().is_multiple_of(WORDS) && from.len() == to.len() {
            // SAFETY: where `to` begins was tested, and whether the processor has AVX was asked.
            unsafe {
                if self.wide {
                    copy_halves(from, to);
                } else {
                    copy_quarters(from, to);
                }
            }
            return;
        }
        to.copy_from_slice(from);
    }
}

/// Copies whole cache lines half a line at a time: in half the time that quarters take, where the memory is
/// what is waited for.
///
/// # Safety
///
/// `to` begins where a cache line does.
#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx")]
#[inline]
unsafe fn copy_halves<T: Word>(from: &[T], to: &mut [T]) {
    use std::arch::x86_64::{_mm256_loadu_ps, _mm256_stream_ps};
    let (from, to) = (from.as_chunks::<8>().0, to.as_chunks_mut::<8>().0);
    for (from, to) in from.iter().zip(to) {
        debug_assert!(to.as_ptr().addr() % size_of_val(to) == 0);
        // SAFETY: both are 32 bytes of numbers for which each pattern of bits is a value, and the second
        // starts at a multiple of 32 bytes: the first at a multiple of 64, as is promised, and so on.
        unsafe {
            let words = _mm256_loadu_ps(from.as_ptr().cast());
            _mm256_stream_ps(to.as_mut_ptr().cast(), words);
        }
    }
}

/// As [`copy_halves`], on every x86-64.
///
/// # Safety
///
/// `to` begins where a cache line does.
#[cfg(target_arch = "x86_64")]
#[inline(always)]
unsafe fn copy_quarters<T: Word>(from: &[T], to: &mut [T]) {
    use std::arch::x86_64::{_mm_loadu_ps, _mm_stream_ps};
    let (from, to) = (from.as_chunks::<4>().0, to.as_chunks_mut::<4>().0);
    for (from, to) in from.iter().zip(to) {
        debug_assert!(to.as_ptr().addr() % size_of_val(to) == 0);
        // SAFETY: part of every x86-64; both are 16 bytes of numbers for which each pattern of bits is a
        // value, and the second starts at a multiple of 16 bytes, as in `copy_halves`.
        unsafe {
            let words = _mm_loadu_ps(from.as_ptr().cast());
            _mm_stream_ps(to.as_mut_ptr().cast(), words);
        }
    }
}

impl Drop for Stream {
    fn drop(&mut self) {
        #[cfg(target_arch = "x86_64")]
        // SAFETY: part of every x86-64; it takes nothing.
        unsafe {
            std::arch::x86_64::_mm_sfence();
        }
    }
}

#[cfg(all(test, target_arch = "x86_64"))]
mod tests {
    use super::*;

    #[test]
    fn lines_arrive_whatever_is_written_at_a_time() {
        let words: Vec<u32> = (0..500).collect();
        for wide in [false, is_x86_feature_detected!("avx")] {
            let mut memory = vec![u32::MAX; 200];
            let first = (WORDS - past_border(&memory, 0)) % WORDS;
            assert_eq!(
                past_border(&memory, first),
                0,
                "else nothing goes past the caches"
            );
            let stream = Stream {
                wide,
                ..Stream::new()
            };
            let lines = 7 * WORDS;
            stream.copy(&words[3..][..lines], &mut memory[first..][..lines]);
            drop(stream);
            assert_eq!(memory[first..][..lines], words[3..][..lines]);
            let beside = memory[..first].iter().chain(&memory[first + lines..]);
            assert!(beside.into_iter().all(|&word| word == u32::MAX));
        }
    }
}
