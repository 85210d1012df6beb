//! Codes of few bits in 32-bit words.

/// A stream of codes of up to eight bits without gaps, the lowest bits of a word first.
#[derive(Debug, Clone, Copy)]
pub(super) struct BitStream<'a> {
    pub words: &'a [u32],
    /// Index of its first word.
    pub first: usize,
    /// Words from one of its words to the next.
    pub stride: usize,
    /// Bits of a code.
    pub bits: u32,
}

impl BitStream<'_> {
    /// The code of this index; 0 behind the end of the words.
    #[inline]
    pub(super) fn code(self, index: usize) -> u8 {
        let bit = index * self.bits as usize;
        let word = |index: usize| {
            let word = self.words.get(self.first + index * self.stride);
            u64::from(word.copied().unwrap_or(0))
        };
        let (first, within) = (bit / 32, bit % 32);
        let mut code = word(first) >> within;
        if within + self.bits as usize > 32 {
            code |= word(first + 1) << (32 - within);
        }
        (code & ((1 << self.bits) - 1)) as u8
    }
}

/// Words of `codes` codes of `bits` bits.
pub(super) fn words_of(codes: usize, bits: u32) -> Option<usize> {
    Some(codes.checked_mul(bits as usize)?.div_ceil(32))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn codes_are_found_at_any_width_and_stride(
            bits in 1_u32..9, stride in 1_usize..4, codes in proptest::collection::vec(any::<u8>(), 1..70),
        ) {
            let codes: Vec<u8> = codes.iter().map(|code| (u32::from(*code) & ((1 << bits) - 1)) as u8).collect();
            let mut words = vec![0_u32; words_of(codes.len(), bits).unwrap() * stride];
            for (index, code) in codes.iter().enumerate() {
                for bit in 0..bits {
                    let place = index * bits as usize + bit as usize;
                    words[place / 32 * stride] |= (u32::from(*code) >> bit & 1) << (place % 32);
                }
            }
            let stream = BitStream { words: &words, first: 0, stride, bits };
            let found: Vec<u8> = (0..codes.len()).map(|index| stream.code(index)).collect();
            prop_assert_eq!(found, codes);
        }
    }

    #[test]
    fn behind_the_words_are_zeros() {
        let stream = BitStream {
            words: &[u32::MAX],
            first: 0,
            stride: 1,
            bits: 3,
        };
        // The eleventh code has two of its bits in the word.
        assert_eq!([9, 10, 11].map(|index| stream.code(index)), [7, 3, 0]);
    }
}
