//! Inputs from a seed: bytes, and texts that are almost right.

/// Splitmix64 (Steele, Lea and Flood, 2014): the same numbers in every run.
#[derive(Debug, Clone)]
pub struct Rng(pub u64);

impl Rng {
    /// The next number.
    pub fn word(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    /// A number under `count`; 0 where that is 0.
    pub fn below(&mut self, count: usize) -> usize {
        usize::try_from(self.word() >> 1).map_or(0, |word| word.checked_rem(count).unwrap_or(0))
    }

    /// So many bytes.
    pub fn bytes(&mut self, count: usize) -> Vec<u8> {
        (0..count).map(|_| self.word().to_le_bytes()[0]).collect()
    }
}

/// What numbers, words and marks are exchanged for.
const ODD: [&str; 30] = [
    "nan",
    "NaN",
    "inf",
    "-inf",
    "Infinity",
    "1e999",
    "-1e308",
    "1e-320",
    "-0.0",
    "0",
    "-1",
    "1.5",
    "99999999999999999999",
    "9223372036854775807",
    "-2147483648",
    "65536",
    "true",
    "\"\"",
    "[]",
    "{}",
    "null",
    "[[cable]]",
    "[[winch]]",
    "\"../../etc/passwd\"",
    "\u{0}",
    "é",
    "\u{2028}",
    "=",
    "]",
    "\n",
];

/// A text with one to six mistakes.
pub fn mistake(rng: &mut Rng, text: &str) -> String {
    let mut text = text.to_owned();
    for _ in 0..=rng.below(6) {
        text = one(rng, &text);
    }
    text
}

fn one(rng: &mut Rng, text: &str) -> String {
    let odd = ODD.get(rng.below(ODD.len())).copied().unwrap_or_default();
    let lines: Vec<&str> = text.lines().collect();
    let line = rng.below(lines.len());
    match rng.below(8) {
        // A token for an odd one: numbers above all.
        0..=3 => {
            let starts: Vec<usize> = text
                .char_indices()
                .zip(text.chars().skip(1))
                .filter(|((_, before), after)| {
                    !before.is_ascii_alphanumeric() && (after.is_ascii_digit() || *after == '-')
                })
                .map(|((at, before), _)| at + before.len_utf8())
                .collect();
            let Some(&at) = starts.get(rng.below(starts.len())) else {
                return text.to_owned() + odd;
            };
            let (head, tail) = text.split_at(at);
            let rest = tail.trim_start_matches(|c: char| {
                c.is_ascii_digit() || matches!(c, '.' | '-' | '+' | 'e' | 'E' | '_')
            });
            format!("{head}{odd}{rest}")
        }
        4 => without(&lines, line),
        5 => {
            let again = lines.get(line).copied().unwrap_or_default();
            format!("{}\n{again}\n", lines.join("\n"))
        }
        6 => text.chars().take(rng.below(text.len() + 1)).collect(),
        _ => {
            let mut chars: Vec<char> = text.chars().collect();
            let at = rng.below(chars.len());
            if let Some(slot) = chars.get_mut(at) {
                *slot = char::from(rng.word().to_le_bytes()[0]);
            }
            chars.into_iter().collect()
        }
    }
}

fn without(lines: &[&str], line: usize) -> String {
    let kept = lines.iter().enumerate().filter(|(at, _)| *at != line);
    kept.map(|(_, text)| format!("{text}\n")).collect()
}

/// Bytes with some changed, cut off or repeated.
pub fn damage(rng: &mut Rng, bytes: &[u8]) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    for _ in 0..=rng.below(8) {
        let at = rng.below(bytes.len());
        match rng.below(4) {
            0 => bytes.truncate(at),
            1 => bytes.extend_from_within(at..),
            _ => {
                if let Some(slot) = bytes.get_mut(at) {
                    *slot = rng.word().to_le_bytes()[0];
                }
            }
        }
    }
    bytes
}
