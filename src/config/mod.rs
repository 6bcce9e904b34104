//! Options: defaults, preset, file, flags, in rising precedence.
