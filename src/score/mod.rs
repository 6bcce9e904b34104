//! Truth + reconstruction → scores, one file per protocol.
