//! What was read last, within a budget of memory.

use crate::error::Result;
use crate::parallel;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Values by number; the least recently used ones go when the budget is spent.
pub(super) struct Cache<T> {
    budget: usize,
    used: usize,
    clock: u64,
    entries: BTreeMap<usize, Entry<T>>,
}

struct Entry<T> {
    value: Arc<T>,
    bytes: usize,
    last_used: u64,
}

impl<T: Send + Sync> Cache<T> {
    /// A cache of about `budget` bytes; what one call asks for is held in any case.
    pub(super) fn new(budget: usize) -> Self {
        Self {
            budget,
            used: 0,
            clock: 0,
            entries: BTreeMap::new(),
        }
    }

    /// The values of `wanted`, in that order; those not at hand come from `load`, in parallel, with
    /// their size in bytes.
    pub(super) fn get(
        &mut self,
        wanted: &[usize],
        load: impl Fn(usize) -> Result<(T, usize)> + Sync + Send,
    ) -> Result<Vec<Arc<T>>> {
        self.clock += 1;
        for index in wanted {
            if let Some(entry) = self.entries.get_mut(index) {
                entry.last_used = self.clock;
            }
        }
        let mut missing: Vec<usize> = wanted.to_vec();
        missing.retain(|index| !self.entries.contains_key(index));
        missing.sort_unstable();
        missing.dedup();
        let expected = missing.len() * self.used / self.entries.len().max(1);
        self.evict(expected);
        let loaded = parallel::try_map(missing.len(), |at| load(missing[at]))?;
        for (index, (value, bytes)) in missing.into_iter().zip(loaded) {
            let entry = Entry {
                value: Arc::new(value),
                bytes,
                last_used: self.clock,
            };
            self.used += bytes;
            self.entries.insert(index, entry);
        }
        self.evict(0);
        let held = |index| {
            self.entries
                .get(index)
                .map(|entry| Arc::clone(&entry.value))
        };
        Ok(wanted.iter().filter_map(held).collect())
    }

    /// Makes room for `coming` bytes, keeping what the present call uses.
    fn evict(&mut self, coming: usize) {
        while self.used + coming > self.budget {
            let oldest = self.entries.iter().min_by_key(|(_, entry)| entry.last_used);
            let Some((&index, _)) = oldest.filter(|(_, entry)| entry.last_used < self.clock) else {
                return;
            };
            if let Some(entry) = self.entries.remove(&index) {
                self.used -= entry.bytes;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicUsize, Ordering};

    #[test]
    fn the_least_recently_used_goes_first_and_wanted_ones_stay() {
        let loads = AtomicUsize::new(0);
        let load = |index: usize| {
            loads.fetch_add(1, Ordering::Relaxed);
            Ok((index * 10, 100))
        };
        let mut cache = Cache::new(300);
        let get = |cache: &mut Cache<usize>, wanted: &[usize]| -> Vec<usize> {
            cache
                .get(wanted, load)
                .unwrap()
                .iter()
                .map(|v| **v)
                .collect()
        };
        assert_eq!(get(&mut cache, &[1, 2, 3]), [10, 20, 30]);
        assert_eq!(get(&mut cache, &[1]), [10]);
        assert_eq!(get(&mut cache, &[4, 2]), [40, 20]);
        assert_eq!(loads.load(Ordering::Relaxed), 4, "3 went, 2 stayed");
        assert_eq!(get(&mut cache, &[2, 3]), [20, 30]);
        assert_eq!(loads.load(Ordering::Relaxed), 5);
        let many: Vec<usize> = (0..10).collect();
        assert_eq!(
            get(&mut cache, &many).len(),
            10,
            "more than the budget in one call"
        );
    }
}
