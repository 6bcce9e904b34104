#![no_main]
//! MVSNet pair.txt.

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    if let Ok(text) = std::str::from_utf8(bytes) {
        let _ = mvs_datasets::format::pair::read(text);
    }
});
