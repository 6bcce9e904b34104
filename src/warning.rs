//! Warnings are values that advise; the library never prints.

use serde::{Deserialize, Serialize};
use std::sync::{Mutex, PoisonError};

/// Something the user should know about a result that was made nevertheless.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Warning {
    /// A stable name to test for, e.g. `few-inliers`.
    pub code: String,
    /// One sentence with the numbers and what to do about it.
    pub message: String,
}

impl Warning {
    /// A warning named `code` saying `message`.
    pub fn new(code: impl Into<String>, message: impl Into<String>) -> Self {
        Self {
            code: code.into(),
            message: message.into(),
        }
    }
}

/// One pixel in so many may show the back of a triangle without a word: where a surface has an edge it
/// is seen from behind (of the real scenes at hand, at most 3 in 100 pixels are).
const BACKS_OF: usize = 10;

/// A warning where so many pixels show the backs of triangles that faces seem wound the wrong way.
pub(crate) fn of_back_faces(backs: usize, fronts: usize) -> Option<Warning> {
    let all = backs + fronts;
    let message = if backs > fronts {
        format!(
            "{backs} pixels show the backs of triangles and {fronts} their fronts: if the faces are \
             wound the other way, --back-faces valid takes both sides"
        )
    } else if backs > 0 && BACKS_OF * backs >= all {
        format!(
            "{backs} of {all} pixels that see the mesh ({} %) show the backs of triangles, which hide what \
             is behind them and have no depth: a part of the faces may be wound the other way, or lie there \
             twice, once each way; make the winding consistent, or take both sides, --back-faces valid",
            100 * backs / all
        )
    } else {
        return None;
    };
    Some(Warning::new("back-faces", message))
}

/// Where warnings are collected while work runs on several threads.
#[derive(Debug, Default)]
pub struct Warnings {
    collected: Mutex<Vec<Warning>>,
}

impl Warnings {
    /// Adds a warning.
    pub fn add(&self, code: &str, message: impl Into<String>) {
        let mut collected = self
            .collected
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        collected.push(Warning::new(code, message));
    }

    /// What was collected, sorted so that the order does not depend on threads.
    pub fn sorted(&self) -> Vec<Warning> {
        let mut all = self
            .collected
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .clone();
        all.sort();
        all.dedup();
        all
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tenth_of_backs_is_said_and_what_sound_meshes_show_is_not() {
        for (backs, fronts) in [(0, 0), (0, 9), (3, 97), (99, 901)] {
            assert_eq!(of_back_faces(backs, fronts), None, "{backs} {fronts}");
        }
        for (backs, fronts, said) in [
            (100, 900, "100 of 1000 pixels that see the mesh (10 %)"),
            (30, 70, "make the winding consistent"),
            (
                1,
                0,
                "1 pixels show the backs of triangles and 0 their fronts",
            ),
        ] {
            let warning = of_back_faces(backs, fronts).unwrap();
            assert_eq!(warning.code, "back-faces");
            assert!(warning.message.contains(said), "{}", warning.message);
            assert!(warning.message.contains("--back-faces valid"));
        }
    }
}
