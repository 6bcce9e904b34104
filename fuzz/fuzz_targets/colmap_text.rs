#![no_main]
//! COLMAP models as text.

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    if let Ok(text) = std::str::from_utf8(bytes) {
        let _ = mvs_datasets::format::colmap::read_cameras_text(text);
        let _ = mvs_datasets::format::colmap::read_images_text(text);
        let _ = mvs_datasets::format::colmap::read_points_text(text);
        let _ = mvs_datasets::format::colmap::read_frames_text(text);
    }
});
