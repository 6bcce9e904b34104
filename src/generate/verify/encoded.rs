//! Images as they are encoded. Loaders of BlendedMVS open them by PIL, which gives as many channels as there
//! are and leaves EXIF alone, or by OpenCV, which gives three and turns the image as EXIF says.

use super::Finding;
use mvs_datasets::format::image;

/// What in the bytes of an image, which can be read, some loader cannot take or takes otherwise.
pub(super) fn check(name: &str, bytes: &[u8]) -> Vec<Finding> {
    let mut findings = Vec::new();
    if let Some(found) = channels(bytes).filter(|&found| found != 3) {
        let message = format!(
            "expected three channels, red, green and blue, found {found}: loaders that do not convert \
             stop there; save it as RGB"
        );
        findings.push(Finding::fault("image-channels", name, message));
    }
    if let Ok(found @ 2..) = image::read_orientation(bytes) {
        let message = format!(
            "expected an image that is stored upright, found EXIF orientation {found}: some loaders turn \
             it, others do not; turn the pixels and remove the tag"
        );
        findings.push(Finding::fault("image-orientation", name, message));
    }
    if bytes.starts_with(PNG) {
        let message =
            "expected a JPEG, as the name says, found a PNG: most loaders go by content, not all";
        findings.push(Finding::advice("image-is-png", name, message));
    }
    findings
}

/// How a PNG starts.
const PNG: &[u8] = b"\x89PNG\r\n\x1a\n";

/// The channels that a JPEG or PNG has without conversion; a palette is one. `None` where neither says so.
fn channels(bytes: &[u8]) -> Option<u8> {
    if bytes.starts_with(PNG) {
        return match bytes.get(25)? {
            0 | 3 => Some(1),
            2 => Some(3),
            4 => Some(2),
            6 => Some(4),
            _ => None,
        };
    }
    let mut at = 2;
    loop {
        match bytes.get(at..)? {
            // Codes, extensions and conditioning have numbers among those of frames.
            [0xff, marker @ 0xc0..=0xcf, _, _, _, _, _, _, _, count, ..]
                if ![0xc4, 0xc8, 0xcc].contains(marker) =>
            {
                return Some(*count);
            }
            [0xff, 0xff, ..] => at += 1,
            [0xff, _, high, low, ..] => at += 2 + usize::from(u16::from_be_bytes([*high, *low])),
            _ => return None,
        }
    }
}
