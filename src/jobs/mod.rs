//! One file per command: files in, one stage, files out.
