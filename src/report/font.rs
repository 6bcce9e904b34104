//! A dot-matrix font for labels in pictures: capitals, digits and a few signs, five dots by seven.

use mvs_datasets::scene::ColorImage;

/// Dots per glyph: columns and rows.
const GLYPH: (u32, u32) = (5, 7);

/// Writes `text` with its top-left dot at `at`, each dot `dot` pixels wide. Lower case is written as
/// upper case, unknown characters as spaces; what does not fit is cut off.
pub(super) fn write(image: &mut ColorImage, text: &str, at: (u32, u32), dot: u32, ink: [u8; 3]) {
    for (place, character) in (0u32..).zip(text.chars()) {
        let left =
            at.0.saturating_add(place.saturating_mul((GLYPH.0 + 1) * dot));
        let rows = glyph(character.to_ascii_uppercase());
        for (row, bits) in (0u32..).zip(rows) {
            for column in 0..GLYPH.0 {
                if bits >> (GLYPH.0 - 1 - column) & 1 == 1 {
                    square(
                        image,
                        (left.saturating_add(column * dot), at.1 + row * dot),
                        dot,
                        ink,
                    );
                }
            }
        }
    }
}

/// The width of `text` in pixels.
pub(super) fn width(text: &str, dot: u32) -> u32 {
    let count = u32::try_from(text.chars().count()).unwrap_or(u32::MAX);
    count
        .saturating_mul((GLYPH.0 + 1) * dot)
        .saturating_sub(dot)
}

fn square(image: &mut ColorImage, (left, top): (u32, u32), dot: u32, ink: [u8; 3]) {
    for row in top..top.saturating_add(dot).min(image.height()) {
        for column in left..left.saturating_add(dot).min(image.width()) {
            image.set(column, row, ink);
        }
    }
}

fn glyph(character: char) -> [u8; 7] {
    let known = GLYPHS.iter().find(|(name, _)| *name == character);
    known.map_or([0; 7], |&(_, rows)| rows)
}

/// Rows from the top; the highest of five bits is the leftmost dot.
#[rustfmt::skip]
const GLYPHS: [(char, [u8; 7]); 48] = [
    ('A', [0b01110, 0b10001, 0b10001, 0b11111, 0b10001, 0b10001, 0b10001]),
    ('B', [0b11110, 0b10001, 0b10001, 0b11110, 0b10001, 0b10001, 0b11110]),
    ('C', [0b01110, 0b10001, 0b10000, 0b10000, 0b10000, 0b10001, 0b01110]),
    ('D', [0b11110, 0b10001, 0b10001, 0b10001, 0b10001, 0b10001, 0b11110]),
    ('E', [0b11111, 0b10000, 0b10000, 0b11110, 0b10000, 0b10000, 0b11111]),
    ('F', [0b11111, 0b10000, 0b10000, 0b11110, 0b10000, 0b10000, 0b10000]),
    ('G', [0b01110, 0b10001, 0b10000, 0b10111, 0b10001, 0b10001, 0b01111]),
    ('H', [0b10001, 0b10001, 0b10001, 0b11111, 0b10001, 0b10001, 0b10001]),
    ('I', [0b01110, 0b00100, 0b00100, 0b00100, 0b00100, 0b00100, 0b01110]),
    ('J', [0b00111, 0b00010, 0b00010, 0b00010, 0b00010, 0b10010, 0b01100]),
    ('K', [0b10001, 0b10010, 0b10100, 0b11000, 0b10100, 0b10010, 0b10001]),
    ('L', [0b10000, 0b10000, 0b10000, 0b10000, 0b10000, 0b10000, 0b11111]),
    ('M', [0b10001, 0b11011, 0b10101, 0b10101, 0b10001, 0b10001, 0b10001]),
    ('N', [0b10001, 0b11001, 0b10101, 0b10101, 0b10011, 0b10001, 0b10001]),
    ('O', [0b01110, 0b10001, 0b10001, 0b10001, 0b10001, 0b10001, 0b01110]),
    ('P', [0b11110, 0b10001, 0b10001, 0b11110, 0b10000, 0b10000, 0b10000]),
    ('Q', [0b01110, 0b10001, 0b10001, 0b10001, 0b10101, 0b10010, 0b01101]),
    ('R', [0b11110, 0b10001, 0b10001, 0b11110, 0b10100, 0b10010, 0b10001]),
    ('S', [0b01111, 0b10000, 0b10000, 0b01110, 0b00001, 0b00001, 0b11110]),
    ('T', [0b11111, 0b00100, 0b00100, 0b00100, 0b00100, 0b00100, 0b00100]),
    ('U', [0b10001, 0b10001, 0b10001, 0b10001, 0b10001, 0b10001, 0b01110]),
    ('V', [0b10001, 0b10001, 0b10001, 0b10001, 0b10001, 0b01010, 0b00100]),
    ('W', [0b10001, 0b10001, 0b10001, 0b10101, 0b10101, 0b11011, 0b10001]),
    ('X', [0b10001, 0b10001, 0b01010, 0b00100, 0b01010, 0b10001, 0b10001]),
    ('Y', [0b10001, 0b10001, 0b01010, 0b00100, 0b00100, 0b00100, 0b00100]),
    ('Z', [0b11111, 0b00001, 0b00010, 0b00100, 0b01000, 0b10000, 0b11111]),
    ('0', [0b01110, 0b10001, 0b10011, 0b10101, 0b11001, 0b10001, 0b01110]),
    ('1', [0b00100, 0b01100, 0b00100, 0b00100, 0b00100, 0b00100, 0b01110]),
    ('2', [0b01110, 0b10001, 0b00001, 0b00110, 0b01000, 0b10000, 0b11111]),
    ('3', [0b01110, 0b10001, 0b00001, 0b00110, 0b00001, 0b10001, 0b01110]),
    ('4', [0b00010, 0b00110, 0b01010, 0b10010, 0b11111, 0b00010, 0b00010]),
    ('5', [0b11111, 0b10000, 0b11110, 0b00001, 0b00001, 0b10001, 0b01110]),
    ('6', [0b00110, 0b01000, 0b10000, 0b11110, 0b10001, 0b10001, 0b01110]),
    ('7', [0b11111, 0b00001, 0b00010, 0b00100, 0b01000, 0b01000, 0b01000]),
    ('8', [0b01110, 0b10001, 0b10001, 0b01110, 0b10001, 0b10001, 0b01110]),
    ('9', [0b01110, 0b10001, 0b10001, 0b01111, 0b00001, 0b00010, 0b01100]),
    ('-', [0b00000, 0b00000, 0b00000, 0b11111, 0b00000, 0b00000, 0b00000]),
    ('_', [0b00000, 0b00000, 0b00000, 0b00000, 0b00000, 0b00000, 0b11111]),
    ('.', [0b00000, 0b00000, 0b00000, 0b00000, 0b00000, 0b01100, 0b01100]),
    (',', [0b00000, 0b00000, 0b00000, 0b00000, 0b01100, 0b00100, 0b01000]),
    (':', [0b00000, 0b01100, 0b01100, 0b00000, 0b01100, 0b01100, 0b00000]),
    ('/', [0b00001, 0b00001, 0b00010, 0b00100, 0b01000, 0b10000, 0b10000]),
    ('+', [0b00000, 0b00100, 0b00100, 0b11111, 0b00100, 0b00100, 0b00000]),
    ('=', [0b00000, 0b00000, 0b11111, 0b00000, 0b11111, 0b00000, 0b00000]),
    ('%', [0b11000, 0b11001, 0b00010, 0b00100, 0b01000, 0b10011, 0b00011]),
    ('(', [0b00010, 0b00100, 0b01000, 0b01000, 0b01000, 0b00100, 0b00010]),
    ('τ', [0b00000, 0b00000, 0b11111, 0b00100, 0b00100, 0b00101, 0b00010]),
    (')', [0b01000, 0b00100, 0b00010, 0b00010, 0b00010, 0b00100, 0b01000]),
];

#[cfg(test)]
mod tests {
    use super::*;
    use mvs_datasets::scene::Raster;

    #[test]
    fn text_is_cut_at_the_border_and_glyphs_differ() {
        let mut image = Raster::filled(8, 7, [0; 3]).unwrap();
        write(&mut image, "li", (0, 0), 1, [9; 3]);
        let dots: Vec<bool> = image
            .values()
            .iter()
            .map(|&value| value == [9; 3])
            .collect();
        assert!((0..7).all(|row| dots[row * 8]), "the stem of the L");
        assert!(dots[6 * 8 + 4] && !dots[4]);
        assert!(dots[7], "the I begins");
        for (index, (_, rows)) in GLYPHS.iter().enumerate() {
            assert!(GLYPHS[..index].iter().all(|(_, other)| other != rows));
        }
    }
}
