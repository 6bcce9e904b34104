//! Which part of a scene one process makes.

use std::str::FromStr;

/// A part of the work on a scene.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Part {
    /// All of it.
    #[default]
    All,
    /// Every `count`-th of the given views by ascending id, from place `index` (from 1) on, and none
    /// of the files that belong to the scene as a whole. Processes may make different shards of one
    /// scene at the same time; each looks for source views on its own where occlusion is asked for.
    Shard {
        /// From 1 to `count`.
        index: usize,
        /// How many shards there are.
        count: usize,
    },
    /// The files that belong to the scene as a whole; all views must be finished.
    Merge,
}

impl Part {
    /// Whether the view at this place of the given views, by ascending id, belongs to the part.
    pub fn holds(self, place: usize) -> bool {
        match self {
            Self::All | Self::Merge => true,
            Self::Shard { index, count } => place % count + 1 == index,
        }
    }
}

impl FromStr for Part {
    type Err = String;

    /// Reads `2/8`: the second of eight shards.
    fn from_str(text: &str) -> Result<Self, String> {
        let whole = |part: &str| part.trim().parse::<usize>().ok();
        let read = (text.split_once('/')).and_then(|(i, n)| Some((whole(i)?, whole(n)?)));
        match read {
            Some((index, count)) if (1..=count).contains(&index) => {
                Ok(Self::Shard { index, count })
            }
            _ => Err(format!(
                "expected a shard as i/n with i from 1 to n, found `{text}`"
            )),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shards_hold_every_view_once() {
        for count in [1, 2, 3, 7] {
            let shards: Vec<Part> = (1..=count)
                .map(|index| format!("{index}/{count}").parse().unwrap())
                .collect();
            for place in 0..20 {
                let holders = shards.iter().filter(|shard| shard.holds(place));
                assert_eq!(holders.count(), 1);
            }
        }
        assert!("2/3".parse::<Part>().unwrap().holds(4));
        for text in ["", "0/3", "4/3", "1", "a/b", "1/0"] {
            assert!(text.parse::<Part>().is_err(), "{text}");
        }
    }
}
