//! What several tests share.

use assert_cmd::Command;
use mvs_datasets::format::image;
use mvs_datasets::layout::files::write_atomically;
use mvs_datasets::scene::ColorImage;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Output;

/// What has this name in the folder with real data (the folder itself for no name), or `None` with
/// a line on stderr that says what is skipped. Where `MVS_EVAL_DATA` names that folder nothing is skipped:
/// what it lacks is a failure.
pub(crate) fn real_data(name: &str) -> Option<PathBuf> {
    let beside = || PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../shared/data"));
    let given = std::env::var_os("MVS_EVAL_DATA").map(PathBuf::from);
    let path = given.clone().unwrap_or_else(beside).join(name);
    if path.exists() {
        return Some(path);
    }
    let path = path.display();
    assert!(given.is_none(), "MVS_EVAL_DATA: {path} is not there");
    say_skipped(&format!(
        "{path} is not there; MVS_EVAL_DATA can name the folder with real data"
    ));
    None
}

/// Says why a test is skipped. Not by a macro: what those print in a test that passes is not shown.
pub(crate) fn say_skipped(why: &str) {
    writeln!(std::io::stderr(), "skipped: {why}").expect("stderr is open");
}

/// Runs `mvs-eval` with these arguments.
pub(crate) fn mvs_eval(arguments: &[&str]) -> Output {
    let mut command = Command::new(assert_cmd::cargo::cargo_bin!("mvs-eval"));
    command
        .args(arguments)
        .output()
        .expect("mvs-eval can be started")
}

/// A path as an argument.
pub(crate) fn text(path: &Path) -> &str {
    path.to_str().expect("test paths are UTF-8")
}

/// What was said on stderr.
pub(crate) fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// Makes a file.
pub(crate) fn write(path: &Path, content: impl AsRef<[u8]>) {
    write_atomically(path, |out| out.write_all(content.as_ref())).expect("a file can be written");
}

/// A JPEG whose EXIF says this orientation.
pub(crate) fn turned_jpeg(picture: &ColorImage, orientation: u8) -> Vec<u8> {
    let mut jpeg = Vec::new();
    image::write_jpeg(&mut jpeg, picture, image::JpegOptions::default())
        .expect("it can be written");
    let mut exif = b"\xff\xe1\x00\x22Exif\0\0II*\0\x08\0\0\0\x01\0".to_vec();
    exif.extend(b"\x12\x01\x03\0\x01\0\0\0"); // orientation, one u16
    exif.extend([orientation, 0, 0, 0, 0, 0, 0, 0]);
    jpeg.splice(2..2, exif);
    jpeg
}
