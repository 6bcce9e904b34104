//! Records to files that people read.
