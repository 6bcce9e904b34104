#![no_main]
//! COLMAP models as binary.

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let _ = mvs_datasets::format::colmap::read_cameras_binary(bytes);
    let _ = mvs_datasets::format::colmap::read_images_binary(bytes);
    let _ = mvs_datasets::format::colmap::read_points_binary(bytes);
    let _ = mvs_datasets::format::colmap::read_frames_binary(bytes);
});
