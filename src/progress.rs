//! Progress and interruption, passed in: the library neither prints nor listens to signals.

use crate::error::{Error, Result};

/// Hears how far long work is, and says whether to stop.
pub trait Progress: Sync {
    /// A stage of `total` steps begins; the one before has ended.
    fn begin(&self, stage: &str, total: u64);
    /// `steps` more steps of the stage are done. Called from any thread.
    fn advance(&self, steps: u64);
    /// Whether the user wants the work to stop.
    fn cancelled(&self) -> bool;

    /// Lets work go on, unless the user wants it to stop.
    ///
    /// # Errors
    /// [`Error::Interrupted`] if the user wants the work to stop.
    fn check(&self) -> Result<()> {
        if self.cancelled() {
            Err(Error::Interrupted)
        } else {
            Ok(())
        }
    }
}

/// Hears nothing and never stops.
#[derive(Debug, Clone, Copy, Default)]
pub struct Silent;

impl Progress for Silent {
    fn begin(&self, _stage: &str, _total: u64) {}
    fn advance(&self, _steps: u64) {}
    fn cancelled(&self) -> bool {
        false
    }
}
