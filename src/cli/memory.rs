//! How large buffers come from the system and go back to it.
#![allow(
    unsafe_code,
    reason = "an allocator and the C library's settings, which no crate of ours wraps"
)]

/// `M_MMAP_THRESHOLD` of glibc's `malloc.h`.
const MMAP_THRESHOLD: i32 = -3;
/// `M_TRIM_THRESHOLD`.
const TRIM_THRESHOLD: i32 = -1;

/// `M_ARENA_MAX`.
const ARENAS: i32 = -8;

/// Sets a parameter of glibc's allocator, over what the environment says; elsewhere nothing. Called while
/// there is one thread: others would read the parameters without a lock.
fn set(parameter: i32, value: i32) {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    {
        unsafe extern "C" {
            fn mallopt(parameter: i32, value: i32) -> i32;
        }
        // SAFETY: changes numbers of the allocator, which it reads under no lock; there is no other thread.
        unsafe { mallopt(parameter, value) };
    }
    #[cfg(not(all(target_os = "linux", target_env = "gnu")))]
    let _ = (parameter, value);
}

/// Has large buffers take over the pages of those before, and what is below 2 MiB but above 256 KiB go
/// back to the system when freed.
///
/// The peak is that of the buffers alive at a time, as if each went back to the system at once, without
/// the page faults that this costs: a sixth of the time of scoring. glibc raises its own limit to the
/// size of what was freed last, up to 32 MiB: clouds of a million points then leave holes that keep a
/// quarter of the peak.
pub(super) fn reuse_large_buffers() {
    set(MMAP_THRESHOLD, 1 << 18);
    // The small buffers of one step serve the next.
    set(TRIM_THRESHOLD, 1 << 22);
    #[cfg(all(
        target_os = "linux",
        target_env = "gnu",
        any(target_arch = "x86_64", target_arch = "aarch64")
    ))]
    pages::take_over();
}

/// Has freed buffers stay with the program: one view after the other wants the same ones, and pages that
/// are given back are filled with zeros anew, a tenth of the time of a generated image. The threads share
/// one pool, if this is called before they start: of a thread's own, glibc gives what is large and free back
/// to the system whatever it is told. Few allocations are large or often enough to meet there.
pub(super) fn keep_buffers() {
    set(ARENAS, 1);
    // The most that glibc takes; it ignores what is above.
    set(MMAP_THRESHOLD, 1 << 25);
    set(TRIM_THRESHOLD, i32::MAX);
}

/// As [`keep_buffers`], and asks the system to put the first 64 MiB of the pool into pages of 2 MiB where it has
/// them: maps are read once into memory that is new, and a fault for each 4 KiB costs a fifteenth of the time of
/// fusing. What is not used is address space alone.
pub(super) fn keep_buffers_in_large_pages() {
    keep_buffers();
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    {
        /// `M_TOP_PAD`.
        const TOP_PAD: i32 = -2;
        const IN_LARGE_PAGES: i32 = 1 << 26;
        /// A multiple of every size of pages.
        const PAGE: usize = 1 << 16;
        /// `MADV_HUGEPAGE` of `sys/mman.h`.
        const HUGE: i32 = 14;
        unsafe extern "C" {
            fn madvise(at: *mut std::ffi::c_void, size: usize, advice: i32) -> i32;
        }
        set(TOP_PAD, IN_LARGE_PAGES);
        // More than is free at the pool's end: it grows by this and what was asked for above.
        let mut end = Vec::<u8>::new();
        let grown = end.try_reserve_exact(1 << 20);
        // What glibc has without being told.
        set(TOP_PAD, 1 << 17);
        if grown.is_err() {
            return;
        }
        let first = end.as_ptr().addr().next_multiple_of(PAGE);
        let size = IN_LARGE_PAGES as usize / PAGE * PAGE;
        // SAFETY: changes no byte, whatever lies there.
        unsafe { madvise(std::ptr::with_exposed_provenance_mut(first), size, HUGE) };
    }
}

#[cfg(all(
    target_os = "linux",
    target_env = "gnu",
    any(target_arch = "x86_64", target_arch = "aarch64")
))]
mod pages {
    use std::alloc::{GlobalAlloc, Layout, System};
    use std::ffi::c_void;
    use std::ptr::null_mut;
    use std::sync::atomic::{AtomicUsize, Ordering};
    use std::sync::{Mutex, PoisonError};

    #[global_allocator]
    static PAGES: Pages = Pages;

    /// The system's allocator. Once [`take_over`] was called, buffers of 2 MiB and more are mappings in
    /// chunks of 2 MiB and a rest; chunks that are freed are kept, and moved into the next buffer by a
    /// change of the page table, which keeps their pages.
    struct Pages;

    /// What moves as a whole: all that one table of pages maps, so that moving it is one entry.
    const CHUNK: usize = 1 << 21;
    /// A multiple of every size of pages.
    const PAGE: usize = 1 << 16;
    /// Chunks kept at most: 16 GiB.
    const MOST: usize = 1 << 13;

    // As `sys/mman.h` of Linux has them on these processors.
    const READ_AND_WRITE: i32 = 3;
    const PRIVATE_ANONYMOUS: i32 = 0x22;
    const AT_THIS_PLACE: i32 = 0x10;
    const MAY_MOVE_TO_PLACE: i32 = 3;

    unsafe extern "C" {
        fn mmap(
            at: *mut c_void,
            size: usize,
            rights: i32,
            flags: i32,
            file: i32,
            first: i64,
        ) -> *mut c_void;
        fn munmap(at: *mut c_void, size: usize) -> i32;
        fn mremap(at: *mut c_void, old: usize, new: usize, flags: i32, ...) -> *mut c_void;
    }

    /// How many large buffers of the system's allocator are alive, or [`MAPPED`]: never both kinds.
    static STATE: AtomicUsize = AtomicUsize::new(0);
    /// Large buffers are mappings from now on.
    const MAPPED: usize = usize::MAX;

    static KEPT: Mutex<Kept> = Mutex::new(Kept {
        chunks: [0; MOST],
        count: 0,
    });

    /// Where freed chunks lie.
    struct Kept {
        chunks: [usize; MOST],
        count: usize,
    }

    /// Has large buffers mapped from now on; false, and nothing changes, while others are alive.
    pub(super) fn take_over() -> bool {
        let taken = STATE.compare_exchange(0, MAPPED, Ordering::SeqCst, Ordering::SeqCst);
        taken.is_ok() || taken == Err(MAPPED)
    }

    fn kept_chunk() -> Option<*mut u8> {
        let mut kept = KEPT.lock().unwrap_or_else(PoisonError::into_inner);
        kept.count = kept.count.checked_sub(1)?;
        Some(std::ptr::with_exposed_provenance_mut(
            kept.chunks[kept.count],
        ))
    }

    /// Gives back what is kept: whether that was anything.
    fn release() -> bool {
        let mut any = false;
        while let Some(chunk) = kept_chunk() {
            // SAFETY: who is kept has no user.
            unsafe { munmap(chunk.cast(), CHUNK) };
            any = true;
        }
        any
    }

    /// What `ask` gives; where it has nothing, what it gives once all that is kept has gone back.
    fn insist(ask: impl Fn() -> *mut u8) -> *mut u8 {
        let at = ask();
        match at.is_null() && release() {
            true => ask(),
            false => at,
        }
    }

    fn is_large(layout: Layout) -> bool {
        layout.size() >= CHUNK && layout.align() <= CHUNK
    }

    /// Whether a buffer of this layout that is alive is a mapping.
    fn is_mapped(layout: Layout) -> bool {
        is_large(layout) && STATE.load(Ordering::SeqCst) == MAPPED
    }

    /// Whether a new buffer of this layout is to be a mapping; if not, it is counted.
    fn is_to_be_mapped(layout: Layout) -> bool {
        let count = |alive: usize| (alive != MAPPED).then(|| alive + 1);
        is_large(layout)
            && STATE
                .fetch_update(Ordering::SeqCst, Ordering::SeqCst, count)
                .is_err()
    }

    /// Counts the end, or the failure, of a buffer that was no mapping.
    fn ended(layout: Layout) {
        if is_large(layout) {
            STATE.fetch_sub(1, Ordering::SeqCst);
        }
    }

    /// A buffer of the system's that was counted before it was there: no longer where it is null.
    fn counted(at: *mut u8, layout: Layout) -> *mut u8 {
        if at.is_null() {
            ended(layout);
        }
        at
    }

    fn failed(at: *mut c_void) -> bool {
        at.addr() == usize::MAX
    }

    /// A mapping of zeros at a multiple of [`CHUNK`], or null.
    fn map(size: usize) -> *mut u8 {
        let Some(length) = size.checked_next_multiple_of(PAGE) else {
            return null_mut();
        };
        let Some(room) = length.checked_add(CHUNK) else {
            return null_mut();
        };
        // SAFETY: a new mapping wherever the system likes; what is given back of it, before and after
        // the part at a multiple, nobody has seen.
        unsafe {
            let all = mmap(null_mut(), room, READ_AND_WRITE, PRIVATE_ANONYMOUS, -1, 0);
            if failed(all) {
                return null_mut();
            }
            let skipped = all.addr().next_multiple_of(CHUNK) - all.addr();
            if skipped > 0 {
                munmap(all, skipped);
            }
            let at = all.byte_add(skipped);
            if skipped < CHUNK {
                munmap(at.byte_add(length), CHUNK - skipped);
            }
            at.cast()
        }
    }

    /// Moves a chunk over another.
    ///
    /// # Safety
    /// Both are chunks of mappings; nobody uses `from` afterwards, or what was in `to`.
    unsafe fn move_chunk(from: *mut u8, to: *mut u8) {
        // SAFETY: as the caller has it. Where the system cannot move it, a new one in its place gets a
        // copy; without that there is a hole in a buffer, and no going on. (A system that gives up midway,
        // having no memory for its own tables, leaves a hole that another thread's mapping could fill
        // before ours replaces it; one that has too many mappings, the case foreseen, says so at once.)
        unsafe {
            if !failed(mremap(from.cast(), CHUNK, CHUNK, MAY_MOVE_TO_PLACE, to)) {
                return;
            }
            let flags = PRIVATE_ANONYMOUS | AT_THIS_PLACE;
            if failed(mmap(to.cast(), CHUNK, READ_AND_WRITE, flags, -1, 0)) {
                std::process::abort();
            }
            to.copy_from_nonoverlapping(from, CHUNK);
            munmap(from.cast(), CHUNK);
        }
    }

    /// Puts kept chunks, whatever they hold, in the place of a mapping's first ones: how many bytes.
    ///
    /// # Safety
    /// `at` is a chunk's place in a mapping of `size` bytes from there on, which nobody has written to.
    unsafe fn fill(at: *mut u8, size: usize) -> usize {
        for first in (0..size / CHUNK * CHUNK).step_by(CHUNK) {
            let Some(chunk) = kept_chunk() else {
                return first;
            };
            // SAFETY: who is kept has no user.
            unsafe { move_chunk(chunk, at.add(first)) };
        }
        size / CHUNK * CHUNK
    }

    /// A new mapping, or null, and how many of its first bytes hold what was in kept chunks; the others
    /// are 0.
    fn mapped(size: usize) -> (*mut u8, usize) {
        let at = insist(|| map(size));
        if at.is_null() {
            return (at, 0);
        }
        // SAFETY: just made.
        (at, unsafe { fill(at, size) })
    }

    /// Keeps whole chunks; gives back those for which there is no room.
    ///
    /// # Safety
    /// They are parts of a mapping and nobody uses them afterwards.
    unsafe fn free_chunks(at: *mut u8, size: usize) {
        let mut first = 0;
        let mut kept = KEPT.lock().unwrap_or_else(PoisonError::into_inner);
        while first < size && kept.count < MOST {
            let count = kept.count;
            // SAFETY: within the mapping.
            kept.chunks[count] = unsafe { at.add(first) }.expose_provenance();
            kept.count += 1;
            first += CHUNK;
        }
        if first < size {
            // SAFETY: as the caller has it.
            unsafe { munmap(at.add(first).cast(), size - first) };
        }
    }

    // SAFETY: the state is MAPPED only after all large buffers of the system's are gone, and for ever. So
    // whether a buffer is a mapping follows from its layout and the state, and each goes back where it
    // came from. Mappings have the size asked for or more, at a multiple of 2 MiB.
    unsafe impl GlobalAlloc for Pages {
        unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
            if is_to_be_mapped(layout) {
                return mapped(layout.size()).0;
            }
            // SAFETY: as the caller has it.
            counted(insist(|| unsafe { System.alloc(layout) }), layout)
        }

        unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
            if is_to_be_mapped(layout) {
                let (at, used) = mapped(layout.size());
                if used == 0 {
                    return at;
                }
                // SAFETY: just made, and no longer than it.
                unsafe { at.write_bytes(0, used) };
                return at;
            }
            // SAFETY: as the caller has it.
            let at = insist(|| unsafe { System.alloc_zeroed(layout) });
            counted(at, layout)
        }

        unsafe fn dealloc(&self, at: *mut u8, layout: Layout) {
            if !is_mapped(layout) {
                // SAFETY: as the caller has it.
                unsafe { System.dealloc(at, layout) };
                return ended(layout);
            }
            let whole = layout.size() / CHUNK * CHUNK;
            let end = layout.size().next_multiple_of(PAGE);
            // SAFETY: the whole of a mapping that the caller does not use again.
            unsafe {
                if end > whole {
                    munmap(at.add(whole).cast(), end - whole);
                }
                free_chunks(at, whole);
            }
        }

        unsafe fn realloc(&self, at: *mut u8, layout: Layout, size: usize) -> *mut u8 {
            // SAFETY: the caller has checked that the size is none too large for a layout.
            let wanted = unsafe { Layout::from_size_align_unchecked(size, layout.align()) };
            if is_large(layout) != is_large(wanted) {
                // SAFETY: a new buffer of the size wanted gets what both have room for.
                return unsafe {
                    let new = self.alloc(wanted);
                    if !new.is_null() {
                        new.copy_from_nonoverlapping(at, layout.size().min(size));
                        self.dealloc(at, layout);
                    }
                    new
                };
            }
            if !is_mapped(layout) {
                // SAFETY: as the caller has it; it stays large and counted, or small.
                return insist(|| unsafe { System.realloc(at, layout, size) });
            }
            // SAFETY: a mapping that stays one.
            unsafe {
                if size <= layout.size() {
                    shrunk(at, layout.size(), size)
                } else {
                    grown(at, layout.size(), size)
                }
            }
        }
    }

    /// Frees what is past the new end.
    ///
    /// # Safety
    /// `at` is a mapping for `old` bytes, not fewer than `new`; nobody uses its end afterwards.
    unsafe fn shrunk(at: *mut u8, old: usize, new: usize) -> *mut u8 {
        let (end, old_end) = (new.next_multiple_of(PAGE), old.next_multiple_of(PAGE));
        let whole = old / CHUNK * CHUNK;
        let next = end.next_multiple_of(CHUNK).min(old_end);
        // SAFETY: the rest of the chunk in which the new end lies, the chunks after it, and the old rest.
        unsafe {
            if next > end {
                munmap(at.add(end).cast(), next - end);
            }
            if whole > next {
                free_chunks(at.add(next), whole - next);
            }
            if old_end > next.max(whole) {
                let rest = next.max(whole);
                munmap(at.add(rest).cast(), old_end - rest);
            }
        }
        at
    }

    /// A larger mapping with the same bytes, or null.
    ///
    /// # Safety
    /// `at` is a mapping for `old` bytes, fewer than `new`; nobody uses it afterwards but for null.
    unsafe fn grown(at: *mut u8, old: usize, new: usize) -> *mut u8 {
        let place = insist(|| map(new));
        if place.is_null() {
            return place;
        }
        let (whole, old_end) = (old / CHUNK * CHUNK, old.next_multiple_of(PAGE));
        // SAFETY: its chunks move, kept ones follow, and the rest is copied.
        unsafe {
            for first in (0..whole).step_by(CHUNK) {
                move_chunk(at.add(first), place.add(first));
            }
            fill(place.add(whole), new - whole);
            if old_end > whole {
                place
                    .add(whole)
                    .copy_from_nonoverlapping(at.add(whole), old - whole);
                munmap(at.add(whole).cast(), old_end - whole);
            }
        }
        place
    }

    #[cfg(test)]
    mod tests {
        use super::*;

        /// Other tests may have large buffers for a while.
        fn wait_to_take_over() {
            while !take_over() {
                std::thread::yield_now();
            }
        }

        /// Sizes on both sides of the limit, each way; what others wrote before never shows.
        #[test]
        fn buffers_keep_their_bytes_as_they_shrink_and_grow() {
            wait_to_take_over();
            let ends = [0, 1, 7, PAGE - 1, PAGE, PAGE + 1, CHUNK / 2, CHUNK - 1];
            let sizes = (0..40).map(|k: usize| k * k % 11 * CHUNK + ends[k % ends.len()]);
            let byte = |k: usize| (k % 251) as u8;
            let mut buffer: Vec<u8> = Vec::new();
            for size in sizes {
                let other = vec![255u8; size / 2];
                buffer.truncate(size);
                buffer.shrink_to_fit();
                buffer.reserve_exact(size - buffer.len());
                buffer.extend((buffer.len()..size).map(byte));
                assert_eq!(buffer.len(), size);
                assert!(buffer.iter().enumerate().all(|(k, &b)| b == byte(k)));
                assert!(other.iter().all(|&byte| byte == 255));
                drop(other);
                assert!(vec![0u8; size + 3].iter().all(|&byte| byte == 0));
            }
        }

        #[test]
        fn what_is_kept_goes_back_before_memory_is_refused() {
            wait_to_take_over();
            let refused_once = || {
                drop(vec![1u8; CHUNK]);
                let times = std::cell::Cell::new(0);
                let at = insist(|| {
                    times.set(times.get() + 1);
                    match times.get() {
                        1 => null_mut(),
                        _ => std::ptr::dangling_mut(),
                    }
                });
                times.get() == 2 && !at.is_null()
            };
            // Other tests may take the chunk first.
            assert!((0..1000).any(|_| refused_once()));
            assert_eq!(insist(std::ptr::dangling_mut), std::ptr::dangling_mut());
        }

        #[test]
        fn threads_share_what_is_kept() {
            wait_to_take_over();
            std::thread::scope(|scope| {
                for mark in 1..=4u8 {
                    scope.spawn(move || {
                        for round in 0..30usize {
                            let size = (1 + round % 5) * CHUNK + round;
                            let buffer = vec![mark; size];
                            assert!(buffer.iter().all(|&byte| byte == mark));
                        }
                    });
                }
            });
        }
    }
}
