//! Who made a result, from what and how.
