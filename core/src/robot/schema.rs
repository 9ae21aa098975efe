//! The keys of the robot file, each with its unit, range, default and meaning, as data.
//!
//! The table itself is in `SECTIONS` and the tables that it refers to. The parser uses it (known
//! keys, ranges, defaults), the error messages (which key was probably meant) and the test that
//! `docs/robot-file.md` documents all of it. A key that is not here is refused, so the three cannot
//! drift apart.

pub use super::keys::*;

/// Bound on every number of a robot: beyond it sums of products could overflow.
const GREATEST: f64 = 1e9;

/// Lower bound on every positive number of a robot: below it a quotient could overflow.
const LEAST_POSITIVE: f64 = 1e-12;

/// The range a number must lie in, besides -1e9 to 1e9 that holds for all. NaN and infinities are refused everywhere.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Range {
    /// Any number.
    Finite,
    /// Greater than zero.
    Positive,
    /// Zero or more.
    NonNegative,
    /// Zero or more and less than one.
    Fraction,
    /// From the first to the second, both included.
    Within(f64, f64),
}

impl Range {
    /// Whether `value` is a number and lies in the range.
    pub fn contains(self, value: f64) -> bool {
        value.abs() <= GREATEST
            && match self {
                Range::Finite => true,
                Range::Positive => value >= LEAST_POSITIVE,
                Range::NonNegative => value >= 0.0,
                Range::Fraction => (0.0..1.0).contains(&value),
                Range::Within(low, high) => (low..=high).contains(&value),
            }
    }

    /// The range in words, as an error message ends: "must be ...".
    pub fn in_words(self) -> String {
        match self {
            Range::Finite => "a number from -1e9 to 1e9".into(),
            Range::Positive => "a number greater than 0 (1e-12 to 1e9)".into(),
            Range::NonNegative => "a number, 0 or greater (to 1e9)".into(),
            Range::Fraction => "0 or greater and less than 1".into(),
            Range::Within(low, high) => format!("from {low} to {high}"),
        }
    }
}

/// What a key holds.
#[derive(Debug, Clone, Copy)]
pub enum Kind {
    /// A non-empty text.
    Text,
    /// One of the listed words.
    Word(&'static [&'static str]),
    /// `true` or `false`.
    Switch,
    /// A whole number from the first to the second, both included.
    Whole(i64, i64),
    /// A number, written with or without a decimal point.
    Number(Range),
    /// A list of numbers; the permitted counts, and the range of each number.
    List(&'static [usize], Range),
    /// A list of rows of numbers: number of rows, numbers in a row.
    Rows(usize, usize),
    /// A table `[name]` (or inline) with keys of its own.
    Table(&'static Section),
    /// A list of tables `[[name]]`, each with the keys of the section.
    Tables(&'static Section),
    /// A table of values that all tables of the section have in common, none of them required.
    Common(&'static Section),
}

/// What an absent key means.
#[derive(Debug, Clone, Copy)]
pub enum Absent {
    /// The key is required.
    Required,
    /// This number is the default.
    Number(f64),
    /// These numbers are the default.
    Numbers(&'static [f64]),
    /// This whole number is the default.
    Whole(i64),
    /// This word is the default.
    Word(&'static str),
    /// This switch position is the default.
    Switch(bool),
    /// The default follows from other keys, as described.
    Follows(&'static str),
}

impl Absent {
    /// The default as it is written in the documentation.
    pub fn in_words(self) -> String {
        match self {
            Absent::Required => "required".into(),
            Absent::Number(value) => format!("{value}"),
            Absent::Numbers(values) => {
                let numbers: Vec<String> = values.iter().map(f64::to_string).collect();
                format!("[{}]", numbers.join(", "))
            }
            Absent::Whole(value) => format!("{value}"),
            Absent::Word(word) => format!("\"{word}\""),
            Absent::Switch(on) => format!("{on}"),
            Absent::Follows(rule) => rule.into(),
        }
    }
}

/// One key of the file.
#[derive(Debug, Clone, Copy)]
pub struct Key {
    /// The key as it is written.
    pub name: &'static str,
    /// What it holds.
    pub kind: Kind,
    /// What its absence means.
    pub absent: Absent,
    /// What it means, in one line, with its unit.
    pub meaning: &'static str,
}

/// A table of the file with its keys.
#[derive(Debug, Clone, Copy)]
pub struct Section {
    /// The header as it is written: `[platform]`, `[[cable]]`; the file itself is `the robot file`.
    pub title: &'static str,
    /// The keys in the order of the documentation.
    pub keys: &'static [Key],
}

impl Section {
    /// The key of a name that the program writes: `key!` looks it up at compile time.
    ///
    /// # Panics
    /// If the section has no such key.
    pub const fn named(&'static self, name: &str) -> Named {
        let mut index = 0;
        while index < self.keys.len() {
            if is_same(self.keys[index].name, name) {
                return Named {
                    section: self,
                    key: &self.keys[index],
                };
            }
            index += 1;
        }
        panic!("the section has no key of this name");
    }

    /// The key of this name, if the section has it.
    pub fn key(&self, name: &str) -> Option<&'static Key> {
        self.keys.iter().find(|key| key.name == name)
    }
}

/// A key that is in the table, see `key!`.
#[derive(Debug, Clone, Copy)]
pub struct Named {
    /// The section that has it.
    pub section: &'static Section,
    /// The key.
    pub key: &'static Key,
}

impl Named {
    /// The key as it is written.
    pub const fn name(self) -> &'static str {
        self.key.name
    }
}

/// `==` of texts, which is not available at compile time.
const fn is_same(a: &str, b: &str) -> bool {
    let (a, b) = (a.as_bytes(), b.as_bytes());
    let mut index = 0;
    while index < a.len() && index < b.len() && a[index] == b[index] {
        index += 1;
    }
    index == a.len() && index == b.len()
}

/// The key of a section by its name. A name that the section does not have is a compile error.
macro_rules! key {
    ($section:ident, $name:literal) => {
        const { $crate::robot::schema::$section.named($name) }
    };
}
pub(super) use key;
