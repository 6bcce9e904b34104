#![no_main]
//! NeRF transforms.json.

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    if let Ok(text) = std::str::from_utf8(bytes) {
        let _ = mvs_datasets::format::transforms::read(text);
    }
});
