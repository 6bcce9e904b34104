//! The pipeline's only user of rayon: indexed maps whose results do not depend on threads.

use crate::error::{Error, Result};
use rayon::prelude::*;
use std::sync::atomic::{AtomicUsize, Ordering};

/// More than any machine has processors for; starting each of them is work.
pub const MOST_THREADS: usize = 1024;

/// Runs `work` with at most `threads` threads; 0 stands for all that the machine offers. An error for more
/// than 1024.
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

/// How many threads work at a time. Results must not depend on it; memory may.
pub fn threads() -> usize {
    rayon::current_num_threads().max(1)
}

/// Sorts values; equal ones are not told apart.
pub fn sort<T: Ord + Send>(values: &mut [T]) {
    values.par_sort_unstable();
}

/// `f(0), f(1), … f(count − 1)` in order, computed in parallel.
pub fn map<T: Send>(count: usize, f: impl Fn(usize) -> T + Sync + Send) -> Vec<T> {
    (0..count).into_par_iter().map(f).collect()
}

/// As [`map`], with room for `f` to work in, which is made anew for a few indices at a time.
pub fn map_with<T: Send, R>(
    count: usize,
    room: impl Fn() -> R + Sync + Send,
    f: impl Fn(&mut R, usize) -> T + Sync + Send,
) -> Vec<T> {
    (0..count).into_par_iter().map_init(room, f).collect()
}

/// As [`map`]; the error of the smallest index among those that failed. After a failure nothing new
/// is begun but what comes before it, so that the same error is found at any number of threads.
pub fn try_map<T: Send>(
    count: usize,
    f: impl Fn(usize) -> Result<T> + Sync + Send,
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
    map(count, unless_failed).into_iter().flatten().collect()
}

/// Calls `f(index, chunk)` for every chunk of `size` values, in parallel.
pub fn for_each_chunk<T: Send>(
    values: &mut [T],
    size: usize,
    f: impl Fn(usize, &mut [T]) + Sync + Send,
) {
    values
        .par_chunks_mut(size.max(1))
        .enumerate()
        .for_each(|(index, chunk)| f(index, chunk));
}

/// As [`for_each_chunk`], with room for `f` to work in, which is made anew for a few chunks at a time.
pub fn for_each_chunk_with<T: Send, R>(
    (values, size): (&mut [T], usize),
    room: impl Fn() -> R + Sync + Send,
    f: impl Fn(&mut R, usize, &mut [T]) + Sync + Send,
) {
    values
        .par_chunks_mut(size.max(1))
        .enumerate()
        .for_each_init(room, |room, (index, chunk)| f(room, index, chunk));
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
