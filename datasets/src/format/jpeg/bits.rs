//! Huffman coding of quantised coefficients.

use super::tables::{self, HUFFMAN_TABLES};
use super::transform::Coefficients;

/// Codes of the coefficients of a component.
pub(super) struct Codes {
    dc: [u32; 256],
    /// By zeros before the coefficient × 16 + its size in bits.
    ac: [u32; 256],
}

/// A code and its length in the lowest eight bits.
fn packed(codes: [(u16, u8); 256]) -> [u32; 256] {
    codes.map(|(code, length)| u32::from(code) << 8 | u32::from(length))
}

/// The codes of luma and chroma.
pub(super) fn standard_codes() -> [Codes; 2] {
    let [luma_dc, luma_ac, chroma_dc, chroma_ac] = HUFFMAN_TABLES
        .each_ref()
        .map(|table| packed(tables::codes(table)));
    [
        Codes {
            dc: luma_dc,
            ac: luma_ac,
        },
        Codes {
            dc: chroma_dc,
            ac: chroma_ac,
        },
    ]
}

/// No zeros before, sixteen of them.
const SIXTEEN_ZEROS: usize = 0xf0;

/// Bytes that a stripe's codes take at most: of each coefficient 16 bits of code and 11 of value.
const MOST: usize = 1 << 15;

/// Bits of a few blocks, from the highest of each byte on: what is not as a file has it yet.
pub(super) struct Codings {
    /// With room for eight bytes at any place.
    bytes: Box<[u8; MOST + 8]>,
    /// Whole bytes.
    count: usize,
    /// What follows them, from the highest bit on, and how many bits that are: fewer than eight.
    word: u64,
    used: u32,
}

impl Codings {
    pub(super) fn new() -> Self {
        Self {
            bytes: Box::new([0; MOST + 8]),
            count: 0,
            word: 0,
            used: 0,
        }
    }

    pub(super) fn clear(&mut self) {
        (self.count, self.word, self.used) = (0, 0, 0);
    }

    /// Appends the lowest `length` bits of `bits`, at most 56; all others are zero. (Without a branch: one
    /// that depended on the bits would be guessed wrong now and then.)
    #[inline(always)]
    fn put(&mut self, bits: u64, length: u32) {
        self.used += length;
        self.word |= bits << (64 - self.used);
        let at = self.count % MOST;
        self.bytes[at..at + 8].copy_from_slice(&self.word.to_be_bytes());
        self.count += self.used as usize / 8;
        self.word <<= self.used & 0x38;
        self.used %= 8;
    }

    /// A value of a coefficient's size behind the code of a symbol.
    #[inline(always)]
    fn put_value(&mut self, code: u32, value: i32, size: u32) {
        let low = (value + (value >> 31)) as u32 & ((1 << size) - 1);
        let bits = u64::from(code >> 8) << size | u64::from(low);
        self.put(bits, (code & 0xff) + size);
    }

    /// Appends a block; `before` is the first coefficient of the component's block before.
    #[inline(always)]
    pub(super) fn put_block(
        &mut self,
        coded: &Coefficients,
        block: usize,
        codes: &Codes,
        before: &mut i16,
    ) {
        let first = coded.values[0][block];
        let step = i32::from(first) - i32::from(*before);
        *before = first;
        let size = size_of(step);
        self.put_value(codes.dc[size as usize], step, size);
        let (mut rest, mut last) = (coded.nonzero[block] & !1, 0);
        while rest != 0 {
            let place = rest.trailing_zeros();
            rest &= rest - 1;
            let mut zeros = place - last - 1;
            last = place;
            while zeros > 15 {
                let code = codes.ac[SIXTEEN_ZEROS];
                self.put(u64::from(code >> 8), code & 0xff);
                zeros -= 16;
            }
            let value = i32::from(coded.values[place as usize & 63][block]);
            let size = size_of(value);
            self.put_value(codes.ac[(zeros << 4 | size) as usize & 0xff], value, size);
        }
        if last < 63 {
            self.put(u64::from(codes.ac[0] >> 8), codes.ac[0] & 0xff);
        }
    }
}

/// Bits as a file has them: no 0xff without a zero byte behind.
pub(super) struct Bits {
    bytes: Vec<u8>,
    /// What is not in `bytes` yet, from the highest bit on, and how many bits that are: fewer than eight.
    word: u64,
    used: u32,
}

impl Bits {
    /// Bits behind bytes that are there.
    pub(super) fn after(bytes: Vec<u8>) -> Self {
        Self {
            bytes,
            word: 0,
            used: 0,
        }
    }

    pub(super) fn append(&mut self, codings: &Codings) {
        let (words, rest) = codings.bytes[..codings.count].as_chunks::<8>();
        for word in words {
            self.put_word(u64::from_be_bytes(*word));
        }
        for &byte in rest {
            self.put_some(u64::from(byte) << 56, 8);
        }
        self.put_some(codings.word, codings.used);
    }

    /// Appends the highest `length` bits of `bits`, at most eight; all others are zero.
    fn put_some(&mut self, bits: u64, length: u32) {
        self.word |= bits >> self.used;
        self.used += length;
        if self.used >= 8 {
            self.put_byte((self.word >> 56) as u8);
            self.word <<= 8;
            self.used -= 8;
        }
    }

    #[inline(always)]
    fn put_word(&mut self, bits: u64) {
        const LOWEST: u64 = 0x0101_0101_0101_0101;
        let word = self.word | bits >> self.used;
        self.word = bits << 1 << (63 - self.used);
        let full_bytes = word & !word.wrapping_add(LOWEST) & (LOWEST << 7);
        if full_bytes == 0 {
            self.bytes.extend_from_slice(&word.to_be_bytes());
        } else {
            self.put_bytes(word.to_be_bytes());
        }
    }

    #[inline(never)]
    fn put_bytes(&mut self, bytes: [u8; 8]) {
        for byte in bytes {
            self.put_byte(byte);
        }
    }

    fn put_byte(&mut self, byte: u8) {
        self.bytes.push(byte);
        if byte == 0xff {
            self.bytes.push(0);
        }
    }

    /// The bytes, the last filled with ones.
    pub(super) fn finish(mut self) -> Vec<u8> {
        if self.used > 0 {
            let filled = (self.word >> 56) as u8 | 0xff >> self.used;
            self.put_byte(filled);
        }
        self.bytes
    }
}

/// Bits of a value's size.
#[inline(always)]
fn size_of(value: i32) -> u32 {
    32 - value.unsigned_abs().leading_zeros()
}
