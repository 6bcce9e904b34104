#![no_main]
//! PFM of either kind.

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let _ = mvs_datasets::format::pfm::read(bytes);
});
