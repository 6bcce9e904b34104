//! The pipeline's only user of rayon: indexed maps whose results do not depend on threads.

use crate::error::{Error, Result};
use rayon::prelude::*;
use std::cell::Cell;
use std::sync::atomic::{AtomicUsize, Ordering};

/// More than any machine has processors for; starting each of them is work.
pub const MOST_THREADS: usize = 1024;

/// Runs `work` with at most `threads` threads; 0 stands for all that the machine offers.
///
/// # Errors
/// More than 1024 threads, and threads that the system does not start.
pub fn with_threads<T: Send>(threads: usize, work: impl FnOnce() -> T + Send) -> Result<T> {
    if threads > MOST_THREADS {
        let problem = format!("expected at most {MOST_THREADS} threads, found {threads}");
        return Err(Error::invalid("--threads", problem));
    }
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build()
        .map_err(|error| Error::invalid("--threads", error.to_string()))?;
    Ok(pool.install(work))
}

thread_local! {
    /// What this thread is in the midst of.
    static WORK: Cell<Work> = const { Cell::new(Work::Shared) };
}

/// How a thread works on what it calls the functions here for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Work {
    /// With all others.
    Shared,
    /// With all others, within a piece of [`map_pieces`].
    SharedPiece,
    /// By itself, within a piece.
    Alone,
}

impl Work {
    /// Does `work` in this way.
    fn during<T>(self, work: impl FnOnce() -> T) -> T {
        struct Restore(Work);
        impl Drop for Restore {
            fn drop(&mut self) {
                WORK.set(self.0);
            }
        }
        let _restore = Restore(WORK.replace(self));
        work()
    }
}

/// Does `work` in a frame of its own. Sharing out is a function that calls itself: what is inlined into it
/// is on the stack once per level.
#[inline(never)]
fn apart<T>(work: impl FnOnce() -> T) -> T {
    work()
}

fn alone() -> bool {
    WORK.get() == Work::Alone
}

/// How many threads work at a time on what is given to the functions here. Results must not depend on it;
/// memory may.
pub fn threads() -> usize {
    match alone() {
        true => 1,
        false => rayon::current_num_threads().max(1),
    }
}

/// Sorts values; equal ones are not told apart.
pub fn sort<T: Ord + Send>(values: &mut [T]) {
    match alone() {
        true => values.sort_unstable(),
        false => values.par_sort_unstable(),
    }
}

/// What both do, at the same time where there are threads for it.
pub fn both<A: Send, B: Send>(
    a: impl FnOnce() -> A + Send,
    b: impl FnOnce() -> B + Send,
) -> (A, B) {
    match alone() {
        true => (a(), b()),
        false => rayon::join(|| apart(a), || apart(b)),
    }
}

/// `f(0), f(1), … f(count − 1)` in order, computed in parallel some at a time: for many that are little work.
pub fn map_each<T: Send>(count: usize, f: impl Fn(usize) -> T + Sync + Send) -> Vec<T> {
    const SOME: usize = 1 << 12;
    match alone() {
        true => (0..count).map(f).collect(),
        false => (0..count)
            .into_par_iter()
            .with_min_len(SOME)
            .map(f)
            .collect(),
    }
}

/// Whether `f(0), f(1), … f(count − 1)` all are true, asked some at a time.
pub fn all(count: usize, f: impl Fn(usize) -> bool + Sync + Send) -> bool {
    const SOME: usize = 1 << 14;
    let holds = |first: usize| (first..count.min(first + SOME)).all(&f);
    match alone() {
        true => (0..count).all(f),
        false => (0..count.div_ceil(SOME))
            .into_par_iter()
            .all(|nth| holds(nth * SOME)),
    }
}

/// `f(0), f(1), … f(count − 1)` in order, computed in parallel.
pub fn map<T: Send>(count: usize, f: impl Fn(usize) -> T + Sync + Send) -> Vec<T> {
    match alone() {
        true => (0..count).map(f).collect(),
        false => {
            let apart = |index| apart(|| f(index));
            (0..count).into_par_iter().map(apart).collect()
        }
    }
}

/// As [`map`], with room for `f` to work in, which is made anew for a few indices at a time.
pub fn map_with<T: Send, R>(
    count: usize,
    room: impl Fn() -> R + Sync + Send,
    f: impl Fn(&mut R, usize) -> T + Sync + Send,
) -> Vec<T> {
    if alone() {
        let mut room = room();
        return (0..count).map(|index| f(&mut room, index)).collect();
    }
    let room = || apart(|| Box::new(room()));
    let apart = |room: &mut Box<R>, index| apart(|| f(room, index));
    (0..count).into_par_iter().map_init(room, apart).collect()
}

/// As [`map`], for what may fail. After a failure nothing new is begun but what comes before it, so that the same
/// error is found at any number of threads.
///
/// # Errors
/// That of the smallest index among those that failed.
pub fn try_map<T: Send>(
    count: usize,
    f: impl Fn(usize) -> Result<T> + Sync + Send,
) -> Result<Vec<T>> {
    until_failed(f, |f| map(count, f))
}

/// As [`map`], for large pieces of work, such as a view each, that use the functions here themselves. While
/// there are pieces enough for all threads, each is done by one thread alone; of the last ones, threads that
/// have none left take a share.
///
/// A thread that waits for the shares of others takes up whatever is next. Were that always another piece,
/// it would begin one within the other until its stack overflows, and have all of them in memory. Here at
/// most one is begun within another.
pub fn map_pieces<T: Send>(count: usize, f: impl Fn(usize) -> T + Sync + Send) -> Vec<T> {
    let (begun, threads) = (AtomicUsize::new(0), threads());
    let piece = |index| {
        let left = count - begun.fetch_add(1, Ordering::Relaxed);
        let work = match WORK.get() {
            Work::Shared if left < threads => Work::SharedPiece,
            _ => Work::Alone,
        };
        apart(|| work.during(|| f(index)))
    };
    if alone() {
        return (0..count).map(piece).collect();
    }
    let indices = (0..count).into_par_iter().with_max_len(1);
    indices.map(piece).collect()
}

/// As [`map_pieces`], for what may fail.
///
/// # Errors
/// As [`try_map`].
pub fn try_map_pieces<T: Send>(
    count: usize,
    f: impl Fn(usize) -> Result<T> + Sync + Send,
) -> Result<Vec<T>> {
    until_failed(f, |f| map_pieces(count, f))
}

/// What `all` makes of `f` up to its first failure.
fn until_failed<T, F: Fn(usize) -> Result<T> + Sync + Send>(
    f: F,
    all: impl FnOnce(&(dyn Fn(usize) -> Option<Result<T>> + Sync)) -> Vec<Option<Result<T>>>,
) -> Result<Vec<T>> {
    let failed = AtomicUsize::new(usize::MAX);
    let unless_failed = |index| {
        if index > failed.load(Ordering::Relaxed) {
            return None;
        }
        let result = f(index);
        if result.is_err() {
            failed.fetch_min(index, Ordering::Relaxed);
        }
        Some(result)
    };
    // What was not begun comes after the first failure, at which collecting ends.
    all(&unless_failed).into_iter().flatten().collect()
}

/// Calls `f(index, chunk)` for every chunk of `size` values, in parallel.
pub fn for_each_chunk<T: Send>(
    values: &mut [T],
    size: usize,
    f: impl Fn(usize, &mut [T]) + Sync + Send,
) {
    for_each_chunk_with((values, size), || (), |(), index, chunk| f(index, chunk));
}

/// As [`for_each_chunk`], with room for `f` to work in, which is made anew for a few chunks at a time.
pub fn for_each_chunk_with<T: Send, R>(
    (values, size): (&mut [T], usize),
    room: impl Fn() -> R + Sync + Send,
    f: impl Fn(&mut R, usize, &mut [T]) + Sync + Send,
) {
    let size = size.max(1);
    if alone() {
        let mut room = room();
        let chunks = values.chunks_mut(size).enumerate();
        return chunks.for_each(|(index, chunk)| f(&mut room, index, chunk));
    }
    values.par_chunks_mut(size).enumerate().for_each_init(
        || apart(|| Box::new(room())),
        |room, (index, chunk)| apart(|| f(room, index, chunk)),
    );
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn results_stand_in_order_at_any_thread_count() {
        for threads in [1, 2, 8] {
            let squares = with_threads(threads, || map(1000, |index| index * index)).unwrap();
            assert!(
                squares
                    .iter()
                    .enumerate()
                    .all(|(index, &square)| square == index * index)
            );
        }
    }

    #[test]
    fn pieces_are_done_one_at_a_time_but_for_the_last() {
        thread_local!(static UNDER_WAY: Cell<usize> = const { Cell::new(0) });
        let (shared, most) = (AtomicUsize::new(0), AtomicUsize::new(0));
        let piece = |index: usize| {
            UNDER_WAY.set(UNDER_WAY.get() + 1);
            most.fetch_max(UNDER_WAY.get(), Ordering::Relaxed);
            shared.fetch_add(usize::from(threads() > 1), Ordering::Relaxed);
            // Some shares take longer than others: whoever is done first waits.
            let sum: usize = map(64, |share| {
                let steps = if share % 9 == 0 { 20_000 } else { 200 };
                let last = map(2, |half| (0..steps + half).fold(index, |a, b| a ^ b));
                std::hint::black_box(last).len() + index
            })
            .iter()
            .sum();
            UNDER_WAY.set(UNDER_WAY.get() - 1);
            sum
        };
        for count in [1, 5, 8, 9, 200] {
            shared.store(0, Ordering::Relaxed);
            let sums = with_threads(8, || map_pieces(count, piece)).unwrap();
            assert!((sums.iter().enumerate()).all(|(index, &sum)| sum == 64 * (2 + index)));
            let shared = shared.load(Ordering::Relaxed);
            assert!(shared <= count.min(7), "{shared} of {count} shared");
        }
        assert_eq!(
            with_threads(1, || map_pieces(3, |_| threads())).unwrap(),
            [1; 3]
        );
        assert!(most.load(Ordering::Relaxed) <= 2, "{most:?} on one thread");
        let failing = |index: usize| match index {
            3 | 5 => Err(Error::invalid("index", index.to_string())),
            _ => Ok(index),
        };
        let failed = with_threads(8, || try_map_pieces(50, failing)).unwrap();
        assert_eq!(failed.unwrap_err().to_string(), "index: 3");
    }

    #[test]
    fn more_threads_than_any_machine_runs_are_refused() {
        let refused = with_threads(100_000, || 1).unwrap_err().to_string();
        assert_eq!(
            refused,
            "--threads: expected at most 1024 threads, found 100000"
        );
    }

    #[test]
    fn the_first_error_by_index_wins() {
        let failing = |index: usize| {
            if index % 10 == 7 {
                Err(Error::invalid("index", index.to_string()))
            } else {
                Ok(index)
            }
        };
        assert_eq!(try_map(100, failing).unwrap_err().to_string(), "index: 7");
        let begun = AtomicUsize::new(0);
        let counted = |index: usize| {
            begun.fetch_add(1, Ordering::Relaxed);
            failing(index)
        };
        let alone = with_threads(1, || try_map(1000, counted)).unwrap();
        assert!(
            alone.is_err() && begun.into_inner() < 1000,
            "goes on after a failure"
        );
        assert_eq!(try_map(7, failing).unwrap(), [0, 1, 2, 3, 4, 5, 6]);
    }
}
