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

/// A warning where more pixels show the backs of triangles than their fronts.
pub(crate) fn of_back_faces(backs: usize, fronts: usize) -> Option<Warning> {
    (backs > fronts).then(|| {
        let message = format!(
            "{backs} pixels show the backs of triangles and {fronts} their fronts: if the faces are \
             wound the other way, --back-faces valid takes both sides"
        );
        Warning::new("back-faces", message)
    })
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
