//! Ascending indices with few gaps.

use std::ops::Range;

/// One stretch of indices without a gap.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Stretch {
    /// The first index.
    first: u32,
    /// How many indices come in stretches before.
    before: u32,
}

/// Ascending indices kept as stretches: of a cloud in spatial order a crop leaves few.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Stretches {
    stretches: Vec<Stretch>,
    count: u32,
}

impl Stretches {
    /// The indices below `count`.
    pub fn all(count: u32) -> Self {
        let mut all = Self::default();
        all.push_all(0, count);
        all
    }

    /// How many indices.
    pub fn len(&self) -> usize {
        self.count as usize
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// The indices from the n-th on, at most so many: stretch by stretch.
    pub fn stretches(&self, nth: usize, most: usize) -> impl Iterator<Item = Range<u32>> + '_ {
        let at = self
            .stretches
            .partition_point(|stretch| stretch.before as usize <= nth);
        let ends = self.stretches[at..].iter().map(|stretch| stretch.before);
        let ends = ends.chain([self.count]);
        let own = &self.stretches[at.saturating_sub(1)..];
        let (nth, last) = (nth as u64, nth as u64 + most as u64);
        own.iter().zip(ends).map_while(move |(stretch, end)| {
            let before = u64::from(stretch.before);
            let (from, to) = (nth.max(before), last.min(u64::from(end)));
            let index = |of: u64| stretch.first + (of - before) as u32;
            (from < to).then(|| index(from)..index(to))
        })
    }

    /// The indices from the n-th on.
    pub fn from(&self, nth: usize) -> impl Iterator<Item = u32> + '_ {
        self.stretches(nth, self.len()).flatten()
    }

    /// All indices.
    pub fn iter(&self) -> impl Iterator<Item = u32> + '_ {
        self.from(0)
    }

    /// Adds an index above all before.
    #[inline]
    pub fn push(&mut self, index: u32) {
        self.push_all(index, 1);
    }

    /// Adds so many indices from one on that are above all before.
    #[inline]
    pub fn push_all(&mut self, first: u32, count: u32) {
        let end = self
            .stretches
            .last()
            .map(|last| last.first + (self.count - last.before));
        debug_assert!(end.is_none_or(|end| end <= first));
        if end != Some(first) && count > 0 {
            self.stretches.push(Stretch {
                first,
                before: self.count,
            });
        }
        self.count += count;
    }

    /// Adds those of another that are all above.
    pub fn append(&mut self, other: &Self) {
        let ends = other.stretches.iter().skip(1).map(|stretch| stretch.before);
        for (stretch, end) in other.stretches.iter().zip(ends.chain([other.count])) {
            self.push_all(stretch.first, end - stretch.before);
        }
    }
}

/// Of ascending indices.
impl FromIterator<u32> for Stretches {
    fn from_iter<I: IntoIterator<Item = u32>>(indices: I) -> Self {
        let mut all = Self::default();
        for index in indices {
            all.push(index);
        }
        all
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn indices_come_back_from_any_place() {
        for modulus in [1u32, 2, 3, 7, 50, 1000] {
            let kept = |index: &u32| modulus == 1 || index / modulus % 3 == 1 || index % 97 == 5;
            let expected: Vec<u32> = (0..500).filter(kept).collect();
            let all: Stretches = expected.iter().copied().collect();
            assert_eq!(all.len(), expected.len());
            for nth in 0..=expected.len() {
                assert_eq!(all.from(nth).collect::<Vec<_>>(), expected[nth..]);
            }
            let (low, high) = expected.split_at(expected.len() / 2);
            let mut joined: Stretches = low.iter().copied().collect();
            joined.append(&high.iter().copied().collect());
            joined.append(&Stretches::default());
            assert_eq!(joined, all);
        }
        assert_eq!(Stretches::default().iter().count(), 0);
        assert_eq!(
            Stretches::all(9).iter().collect::<Vec<_>>(),
            [0, 1, 2, 3, 4, 5, 6, 7, 8]
        );
    }
}
