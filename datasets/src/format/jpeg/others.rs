//! JPEGs that the other decoder would read as something else, without a word.

use crate::error::FormatError;

/// An error where a JPEG is cut short, has its components in scans of their own without being progressive, or
/// chroma finer than brightness.
pub(in crate::format) fn check_others(bytes: &[u8]) -> Result<(), FormatError> {
    if !has_end(bytes) {
        let problem =
            "expected a whole JPEG, found one that is cut short: its end marker is missing";
        return Err(FormatError::new(format!("byte {}", bytes.len()), problem));
    }
    let Some((frame, scan)) = frame_and_scan(bytes) else {
        return Ok(());
    };
    let refused = |found: &str| {
        let problem = format!(
            "expected a JPEG as cameras write it, found {found}: save it anew, by ImageMagick, say"
        );
        Err(FormatError::new("header", problem))
    };
    let components = frame.content.get(6..).unwrap_or_default();
    let sampling = || components.iter().skip(1).step_by(3);
    let first = sampling().next().copied().unwrap_or_default();
    let finer = |&sampling: &u8| sampling >> 4 > first >> 4 || sampling & 15 > first & 15;
    if sampling().any(finer) {
        return refused("chroma that is finer than brightness");
    }
    let is_baseline = matches!(frame.marker, 0xc0 | 0xc1);
    if is_baseline
        && usize::from(scan.content.first().copied().unwrap_or_default()) < components.len() / 3
    {
        return refused("components in scans of their own");
    }
    Ok(())
}

/// What stands between two markers.
pub(in crate::format) struct Segment<'b> {
    /// The marker before it.
    pub(in crate::format) marker: u8,
    /// What follows its length.
    pub(in crate::format) content: &'b [u8],
}

/// The marker before the data of a scan.
pub(in crate::format) const SCAN: u8 = 0xda;

/// The segments of a JPEG up to the header of its first scan, or as far as they are whole.
pub(in crate::format) fn segments(bytes: &[u8]) -> impl Iterator<Item = Segment<'_>> {
    let mut at = Some(2);
    std::iter::from_fn(move || {
        let from = at.take()?;
        let rest = bytes.get(from..)?;
        let fill = rest.iter().take_while(|&&byte| byte == 0xff).count();
        let (&marker, rest) = rest[fill..].split_first().filter(|_| fill > 0)?;
        let length = usize::from(u16::from_be_bytes(*rest.first_chunk()?));
        let content = rest.get(2..length)?;
        at = (marker != SCAN).then_some(from + fill + 1 + length);
        Some(Segment { marker, content })
    })
}

/// The start of frame, and the first scan's header.
fn frame_and_scan(bytes: &[u8]) -> Option<(Segment<'_>, Segment<'_>)> {
    let mut frame = None;
    for segment in segments(bytes) {
        match segment.marker {
            SCAN => return Some((frame?, segment)),
            // Starts of frames, but for tables and arithmetic coding, which have their numbers among them.
            0xc0..=0xcf if !matches!(segment.marker, 0xc4 | 0xc8 | 0xcc) => frame = Some(segment),
            _ => {}
        }
    }
    None
}

/// Whether the end marker of a JPEG is there: one of its own, not of a thumbnail in a segment of it.
fn has_end(bytes: &[u8]) -> bool {
    let mut at = 0;
    loop {
        at += bytes[at..].iter().take_while(|&&byte| byte != 0xff).count();
        at += bytes[at..].iter().take_while(|&&byte| byte == 0xff).count();
        let length = bytes.get(at + 1..at + 3);
        match (bytes.get(at), length) {
            (Some(0xd9), _) => return true,
            // What stands alone: a coded 0xff, restarts, the start.
            (Some(0x00 | 0x01 | 0xd0..=0xd8), _) => at += 1,
            (Some(_), Some(&[high, low])) => {
                at += 1 + usize::from(u16::from_be_bytes([high, low]));
            }
            _ => return false,
        }
        if at > bytes.len() {
            return false;
        }
    }
}
