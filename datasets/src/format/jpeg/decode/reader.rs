//! Coded bits → quantised coefficients.

use super::super::transform::Coefficients;

/// Bits that are looked up at once.
const LOOK: u32 = 10;
/// Stands for zeros to the block's end.
const END: u32 = 128;

/// A Huffman table.
#[derive(Clone)]
pub(super) struct Table {
    /// By the next bits, where those hold a code and the value behind it: bits of both, zeros before the
    /// value (eight bits each), and the value; otherwise 0.
    values: Box<[u32; 1 << LOOK]>,
    /// Of the other coefficients, the same in the lower half, but bits of all that is known; where the next
    /// bits hold a second code and value too, 1, its zeros and its value in the upper half.
    pairs: Box<[u64; 1 << LOOK]>,
    /// By the next bits, where those hold a code: its length and its symbol (eight bits each), else 0.
    symbols: Box<[u16; 1 << LOOK]>,
    /// By length: the codes of 16 bits from here on are longer, and what to add to a code for its place.
    longer: [u32; 17],
    places: [i32; 17],
    all: [u8; 256],
}

impl Table {
    /// The table with so many codes of each length from 1 on, for the first coefficients or the others.
    pub(super) fn new(counts: &[u8; 16], symbols: &[u8], first: bool) -> Option<Self> {
        let mut table = Self {
            values: Box::new([0; 1 << LOOK]),
            pairs: Box::new([0; 1 << LOOK]),
            symbols: Box::new([0; 1 << LOOK]),
            longer: [0; 17],
            places: [0; 17],
            all: [0; 256],
        };
        table.all.get_mut(..symbols.len())?.copy_from_slice(symbols);
        // Those of first coefficients are sizes.
        if first && symbols.iter().any(|&size| u32::from(size) > MOST_BITS) {
            return None;
        }
        let (mut code, mut place) = (0u32, 0usize);
        for (length, &count) in (1u32..).zip(counts) {
            table.places[length as usize] = place as i32 - code as i32;
            // As many as there are; the one of ones alone is none.
            if code + u32::from(count) >= 1 << length {
                return None;
            }
            for _ in 0..count {
                table.add(code, length, (symbols[place], first));
                (code, place) = (code + 1, place + 1);
            }
            table.longer[length as usize] = code << (16 - length);
            code <<= 1;
        }
        if !first {
            table.pair_up();
        }
        Some(table)
    }

    /// Looks for second values behind the first ones.
    fn pair_up(&mut self) {
        for (at, pair) in self.pairs.iter_mut().enumerate() {
            let one = self.values[at];
            *pair = u64::from(one);
            if one == 0 || one >> 8 & 0xff == END {
                continue;
            }
            let length = one & 0xff;
            let next = self.values[(at << length) % (1 << LOOK)];
            if next != 0 && length + (next & 0xff) <= LOOK {
                *pair += u64::from(next & 0xff);
                *pair |= 1 << 32 | u64::from(next & !0xff) << 32;
            }
        }
    }

    fn add(&mut self, code: u32, length: u32, (symbol, first): (u8, bool)) {
        if length > LOOK {
            return;
        }
        let rest = LOOK - length;
        let (run, size) = match first {
            true => (0, u32::from(symbol)),
            false => (u32::from(symbol >> 4), u32::from(symbol & 15)),
        };
        for tail in 0..1u32 << rest {
            let at = (code << rest | tail) as usize;
            self.symbols[at] = u16::from(symbol) << 8 | length as u16;
            self.values[at] = match (run, size) {
                (0, 0) if !first => END << 8 | length,
                (_, 0) if !first => 0,
                _ if size > rest => 0,
                _ => {
                    let bits = if size == 0 { 0 } else { tail >> (rest - size) };
                    let value = extended(bits, size) as u16;
                    u32::from(value) << 16 | run << 8 | (length + size)
                }
            };
        }
    }
}

/// The value of `size` bits: those that begin with 0 stand for negative ones.
#[inline(always)]
fn extended(bits: u32, size: u32) -> i16 {
    let half = (1u32 << size) >> 1;
    let below = if bits < half { (1i32 << size) - 1 } else { 0 };
    (bits as i32 - below) as i16
}

/// The coded data without the zeros behind bytes of ones, if the image ends behind it.
pub(super) fn unstuffed(mut coded: &[u8]) -> Option<Vec<u8>> {
    let mut out = Vec::with_capacity(coded.len());
    loop {
        while let Some(eight) = coded.first_chunk::<8>() {
            let word = u64::from_le_bytes(*eight);
            // A byte of ones is the only one that one more makes zero.
            let inverted = !word;
            let any = inverted.wrapping_sub(0x0101_0101_0101_0101) & word & 0x8080_8080_8080_8080;
            if any != 0 {
                break;
            }
            out.extend_from_slice(eight);
            coded = &coded[8..];
        }
        let ones = coded.iter().take(9).position(|&byte| byte == 0xff)?;
        out.extend_from_slice(&coded[..ones]);
        match coded.get(ones + 1)? {
            0 => out.push(0xff),
            0xd9 => return Some(out),
            _ => return None,
        }
        coded = &coded[ones + 2..];
    }
}

/// Bits from the highest of each byte on.
pub(super) struct Bits<'b> {
    bytes: &'b [u8],
    at: usize,
    /// The next bits, from the highest on.
    word: u64,
    count: u32,
}

impl<'b> Bits<'b> {
    pub(super) fn of(bytes: &'b [u8]) -> Self {
        Self {
            bytes,
            at: 0,
            word: 0,
            count: 0,
        }
    }

    /// Whether no more was read than there is.
    pub(super) fn is_within(&self) -> bool {
        8 * self.at - self.count as usize <= 8 * self.bytes.len()
    }

    /// Has at least 56 bits ready, zeros behind the end.
    #[inline(always)]
    fn fill(&mut self) {
        let next = self.bytes.get(self.at..).unwrap_or_default();
        let eight = next.first_chunk().copied();
        let eight = eight.unwrap_or_else(|| last(next));
        self.word |= u64::from_be_bytes(eight) >> self.count;
        self.at += (63 - self.count as usize) / 8;
        self.count |= 56;
    }

    #[inline(always)]
    fn peek(&self, bits: u32) -> usize {
        (self.word >> (64 - bits)) as usize
    }

    #[inline(always)]
    fn skip(&mut self, bits: u32) {
        self.word <<= bits;
        self.count -= bits;
    }

    /// The next symbol, wherever its code ends.
    #[inline(never)]
    fn symbol(&mut self, table: &Table) -> Option<u8> {
        let known = table.symbols[self.peek(LOOK) % (1 << LOOK)];
        if known != 0 {
            self.skip(u32::from(known & 0xff));
            return Some((known >> 8) as u8);
        }
        let code = self.peek(16) as u32;
        let length = (LOOK + 1..=16).find(|&length| code < table.longer[length as usize])?;
        self.skip(length);
        let place = (code >> (16 - length)) as i32 + table.places[length as usize];
        table.all.get(usize::try_from(place).ok()?).copied()
    }

    /// The value of the next `size` bits, at most 15.
    #[inline(always)]
    fn value(&mut self, size: u32) -> i16 {
        if size == 0 {
            return 0;
        }
        let bits = self.peek(size) as u32;
        self.skip(size);
        extended(bits, size)
    }

    /// Reads a block into its column, which is zero; `before` is the first coefficient of the component's
    /// block before.
    #[inline(always)]
    pub(super) fn block(
        &mut self,
        [first, others]: &[Table; 2],
        before: &mut i16,
        (out, block): (&mut Coefficients, usize),
    ) -> Option<()> {
        if self.at > self.bytes.len() + 16 {
            return None;
        }
        self.fill();
        let known = first.values[self.peek(LOOK) % (1 << LOOK)];
        let step = if known != 0 {
            self.skip(known & 0xff);
            (known >> 16) as i16
        } else {
            let size = u32::from(self.symbol(first)?);
            self.value(size)
        };
        *before = before.checked_add(step)?;
        self.others(others, (out, block))?;
        out.values[0][block] = *before;
        Some(())
    }

    /// Reads all but the first coefficient of a block; what it leaves in that one's place means nothing.
    #[inline(always)]
    fn others(&mut self, table: &Table, (out, block): (&mut Coefficients, usize)) -> Option<()> {
        let mut place = 1;
        while place < 64 {
            if self.count < 32 {
                self.fill();
            }
            let known = table.pairs[self.peek(LOOK) % (1 << LOOK)];
            if known == 0 {
                let (run, value) = self.long(table)?;
                place += run;
                if place >= END {
                    return Some(());
                }
                out.values[place as usize % 64][block] = value;
                place += 1;
                continue;
            }
            place += known as u32 >> 8 & 0xff;
            if place >= 63 {
                // What follows is another block's.
                let one = table.values[self.peek(LOOK) % (1 << LOOK)];
                self.skip(one & 0xff);
                if place == 63 {
                    out.values[63][block] = (one >> 16) as i16;
                }
                return (place == 63 || place >= END).then_some(());
            }
            self.skip(known as u32 & 0xff);
            out.values[place as usize % 64][block] = (known >> 16) as i16;
            // Where there is no second value a zero is put behind the first, where it would come.
            place += 1 + ((known >> 40) as u32 & 0xff);
            if place >= END {
                return Some(());
            }
            out.values[place as usize % 64][block] = (known >> 48) as i16;
            place += (known >> 32) as u32 & 0xff;
        }
        // Beyond the block: no encoder writes that.
        (place == 64).then_some(())
    }

    /// Zeros and the value behind them, where both take more bits than are looked up.
    #[inline(never)]
    fn long(&mut self, table: &Table) -> Option<(u32, i16)> {
        let symbol = u32::from(self.symbol(table)?);
        let (run, size) = (symbol >> 4, symbol & 15);
        match (run, size) {
            (0, 0) => Some((END, 0)),
            // Sixteen zeros: fifteen, and one as a value.
            (15, 0) => Some((15, 0)),
            (_, 0) => None,
            _ if size > MOST_BITS => None,
            _ => Some((run, self.value(size))),
        }
    }
}

/// Bits of a coefficient of 8-bit pixels, at most.
const MOST_BITS: u32 = 11;

/// The bytes that are left, then zeros.
#[cold]
fn last(bytes: &[u8]) -> [u8; 8] {
    let mut eight = [0; 8];
    for (out, &byte) in eight.iter_mut().zip(bytes) {
        *out = byte;
    }
    eight
}
