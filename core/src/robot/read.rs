//! From TOML text to values checked one by one against the key table, each with its place.

use std::collections::BTreeMap;
use std::ops::Range as Span;
use std::sync::Arc;

use miette::NamedSource;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

use super::error::{Invalid, Problem, RobotError};
use super::schema::{Absent, Key, Kind, Named, Range, SECTIONS, Section};
use crate::near::nearest;

/// Permitted elements of a list, for messages.
const NUMBERS: &str = "numbers from -1e9 to 1e9";

/// A place in one of the files read for a robot.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct At {
    pub file: usize,
    pub span: Span<usize>,
}

/// A checked value.
#[derive(Debug, Clone)]
pub(super) enum Value {
    Text(String),
    Switch(bool),
    Whole(i64),
    Number(f64),
    Numbers(Vec<f64>),
    Table(Values),
    Tables(Vec<Values>),
}

/// The checked values of one table.
#[derive(Debug, Clone)]
pub(super) struct Values {
    section: &'static Section,
    /// How messages name the table: `cable 3`.
    pub place: String,
    /// The table's header.
    pub at: At,
    found: BTreeMap<&'static str, (Value, At)>,
}

/// The files read so far and the mistakes found in them.
#[derive(Debug, Default)]
pub(super) struct Reader {
    files: Vec<(String, Arc<str>)>,
    problems: Vec<(At, Problem)>,
}

impl Reader {
    /// Adds a file's text; its values will refer to it.
    pub(crate) fn add_file(&mut self, name: &str, text: &str) -> usize {
        self.files.push((name.to_owned(), Arc::from(text)));
        self.files.len() - 1
    }

    /// Notes a mistake.
    pub fn problem(&mut self, at: &At, place: &str, what: String, help: Option<String>) {
        let Some((name, text)) = self.files.get(at.file) else {
            return;
        };
        let before = text.get(..at.span.start).unwrap_or("");
        let problem = Problem {
            file: name.clone(),
            line: 1 + before.matches('\n').count(),
            place: place.to_owned(),
            what,
            help,
            span: at.span.clone().into(),
            text: NamedSource::new(name, Arc::clone(text)).with_language("TOML"),
        };
        self.problems.push((at.clone(), problem));
    }

    /// Whether no mistake has been found.
    pub(crate) fn is_clean(&self) -> bool {
        self.problems.is_empty()
    }

    /// The mistakes as an error, in the order of the files; `None` if there are none.
    pub(crate) fn into_error(mut self) -> Option<RobotError> {
        self.problems
            .sort_by_key(|(at, _)| (at.file, at.span.start));
        let mut problems = self.problems.into_iter().map(|(_, problem)| problem);
        let first = problems.next()?;
        let others = problems.collect();
        Some(RobotError::Invalid(Box::new(Invalid { first, others })))
    }

    /// Reads a file already taken in as a table of the section. Mistakes are noted; a text that is
    /// not TOML gives `None`.
    pub fn read(&mut self, file: usize, section: &'static Section, place: &str) -> Option<Values> {
        let text = Arc::clone(&self.files.get(file)?.1);
        match DeTable::parse(&text) {
            Ok(table) => Some(self.table(file, table.get_ref(), 0..0, section, place)),
            Err(error) => {
                let span = error.span().unwrap_or(0..0);
                let what = error.message().trim_end().replace('\n', ", ");
                let help = "the file is not valid TOML at this place: see https://toml.io for its \
                            rules, and docs/robot-file.md for an example";
                let at = At { file, span };
                self.problem(&at, place, what, Some(help.into()));
                None
            }
        }
    }

    fn table(
        &mut self,
        file: usize,
        table: &DeTable<'_>,
        header: Span<usize>,
        section: &'static Section,
        place: &str,
    ) -> Values {
        let values = self.part(file, table, header, section, place);
        for key in section.keys {
            let given = table.contains_key(key.name);
            if matches!(key.absent, Absent::Required) && !given {
                let what = format!("the key `{}` is missing", key.name);
                let help = format!("add {} = ...: {}", key.name, key.meaning);
                let at = values.at.clone();
                self.problem(&at, place, what, Some(help));
            }
        }
        values
    }

    /// As [`Reader::table`], with required keys missing.
    fn part(
        &mut self,
        file: usize,
        table: &DeTable<'_>,
        header: Span<usize>,
        section: &'static Section,
        place: &str,
    ) -> Values {
        let mut values = Values {
            section,
            place: place.to_owned(),
            at: At { file, span: header },
            found: BTreeMap::new(),
        };
        for (name, value) in table {
            let name_at = At {
                file,
                span: name.span(),
            };
            let Some(key) = section.key(name.get_ref()) else {
                let (what, help) = unknown(name.get_ref(), section);
                self.problem(&name_at, place, what, Some(help));
                continue;
            };
            let at = At {
                file,
                span: value.span(),
            };
            if let Some(checked) = self.value(file, key, value, place) {
                // A table's own span covers its header or braces: point at the name instead.
                let at = match checked {
                    Value::Table(_) | Value::Tables(_) => name_at,
                    _ => at,
                };
                values.found.insert(key.name, (checked, at));
            } else {
                values.found.remove(key.name);
            }
        }
        values
    }

    fn value(
        &mut self,
        file: usize,
        key: &'static Key,
        value: &Spanned<DeValue<'_>>,
        place: &str,
    ) -> Option<Value> {
        let at = At {
            file,
            span: value.span(),
        };
        let given = value.get_ref();
        let checked = match key.kind {
            Kind::Text => text(given),
            Kind::Word(words) => word(given, words),
            Kind::Switch => match given.as_bool() {
                Some(on) => Ok(Value::Switch(on)),
                None => Err(wrong_kind("true or false", given)),
            },
            Kind::Whole(low, high) => whole(given, low, high),
            Kind::Number(range) => match number(given) {
                Some(number) if range.contains(number) => Ok(Value::Number(number)),
                Some(number) => Err(format!("must be {}, not {number}", range.in_words())),
                None => Err(wrong_kind("a number", given)),
            },
            Kind::List(counts, range) => list(given, counts, &range),
            Kind::Rows(rows, columns) => rows_of(given, rows, columns),
            Kind::Table(section) => match given.as_table() {
                Some(table) => {
                    let span = value.span();
                    let title = section.title;
                    Ok(Value::Table(self.table(file, table, span, section, title)))
                }
                None => Err(wrong_kind(&format!("a table {}", section.title), given)),
            },
            Kind::Tables(section) => self.tables(file, key, given, section),
            Kind::Common(section) => match given.as_table() {
                Some(table) => {
                    let span = value.span();
                    Ok(Value::Table(
                        self.part(file, table, span, section, key.name),
                    ))
                }
                None => Err(wrong_kind(&format!("a table [{}]", key.name), given)),
            },
        };
        match checked {
            Ok(checked) => Some(checked),
            Err(what) => {
                let what = format!("`{}` {what}", key.name);
                let help = format!("{}: {}", key.name, key.meaning);
                self.problem(&at, place, what, Some(help));
                None
            }
        }
    }

    /// Tables under repeated headers.
    fn tables(
        &mut self,
        file: usize,
        key: &'static Key,
        given: &DeValue<'_>,
        section: &'static Section,
    ) -> Result<Value, String> {
        let Some(array) = given.as_array() else {
            let wanted = format!("a list of tables, each under a header {}", section.title);
            return Err(wrong_kind(&wanted, given));
        };
        let mut tables = Vec::new();
        for (index, element) in array.iter().enumerate() {
            let place = format!("{} {}", key.name, index + 1);
            let at = At {
                file,
                span: element.span(),
            };
            match element.get_ref().as_table() {
                Some(table) => tables.push(self.table(file, table, at.span, section, &place)),
                None => {
                    let what = format!("must be a table {}", section.title);
                    self.problem(&at, &place, what, None);
                }
            }
        }
        Ok(Value::Tables(tables))
    }
}

fn text(given: &DeValue<'_>) -> Result<Value, String> {
    match given.as_str() {
        Some(text) if !text.trim().is_empty() => Ok(Value::Text(text.to_owned())),
        Some(_) => Err("must not be empty".to_owned()),
        None => Err(wrong_kind("a text in quotes", given)),
    }
}

fn word(given: &DeValue<'_>, words: &[&str]) -> Result<Value, String> {
    match given.as_str() {
        Some(text) if words.contains(&text) => Ok(Value::Text(text.to_owned())),
        Some(text) => Err(format!("must be {}, not \"{text}\"", alternatives(words))),
        None => Err(wrong_kind(&alternatives(words), given)),
    }
}

fn whole(given: &DeValue<'_>, low: i64, high: i64) -> Result<Value, String> {
    let wanted = format!("a whole number from {low} to {high}");
    let DeValue::Integer(digits) = given else {
        return Err(wrong_kind(&wanted, given));
    };
    match i64::from_str_radix(digits.as_str(), digits.radix()) {
        Ok(number) if (low..=high).contains(&number) => Ok(Value::Whole(number)),
        _ => Err(format!("must be {wanted}, not {digits}")),
    }
}

fn list(given: &DeValue<'_>, counts: &[usize], range: &Range) -> Result<Value, String> {
    let Some(list) = numbers(given) else {
        return Err(wrong_kind("a list of numbers, [x, y, z]", given));
    };
    if !counts.contains(&list.len()) {
        let counts: Vec<String> = counts.iter().map(usize::to_string).collect();
        let counts = counts.join(" or ");
        return Err(format!("must hold {counts} numbers, not {}", list.len()));
    }
    match list.iter().find(|number| !range.contains(**number)) {
        Some(bad) => Err(format!("must hold only {NUMBERS}, not {bad}")),
        None => Ok(Value::Numbers(list)),
    }
}

impl Values {
    /// An empty table of a section that is absent from the file: everything is default.
    pub(crate) fn absent(section: &'static Section, place: &str, at: At) -> Self {
        Self {
            section,
            place: place.to_owned(),
            at,
            found: BTreeMap::new(),
        }
    }

    /// The position of the key's value, or of the table if the key is absent.
    pub fn at(&self, key: Named) -> At {
        self.found
            .get(self.own(key))
            .map_or_else(|| self.at.clone(), |(_, at)| at.clone())
    }

    /// Whether the key is given.
    pub fn has(&self, key: Named) -> bool {
        self.found.contains_key(self.own(key))
    }

    /// Takes over the keys of `base` that this table does not give itself.
    pub(crate) fn fill_from(&mut self, base: Values) {
        for (name, found) in base.found {
            self.found.entry(name).or_insert(found);
        }
    }

    /// The header of the tables that it belongs to.
    pub(crate) const fn section_title(&self) -> &'static str {
        self.section.title
    }

    /// Whether no key is given.
    pub(crate) fn is_empty(&self) -> bool {
        self.found.is_empty()
    }

    /// Treats the key as absent, after it has been refused.
    pub(crate) fn forget(&mut self, key: Named) {
        self.found.remove(self.own(key));
    }

    fn given(&self, key: Named) -> Option<&Value> {
        self.found.get(self.own(key)).map(|(value, _)| value)
    }

    /// The key's name.
    ///
    /// # Panics
    /// If the key is of another section: reading any robot file executes this check.
    fn own(&self, key: Named) -> &'static str {
        assert!(
            std::ptr::eq(self.section, key.section),
            "`{}` is a key of {}, not of {}",
            key.name(),
            key.section.title,
            self.section.title
        );
        key.name()
    }

    /// The number given, or its fixed default.
    pub fn number(&self, key: Named) -> f64 {
        match (self.number_given(key), key.key.absent) {
            (Some(number), _) | (None, Absent::Number(number)) => number,
            _ => 0.0,
        }
    }

    /// The number given.
    pub(crate) fn number_given(&self, key: Named) -> Option<f64> {
        match self.given(key) {
            Some(Value::Number(number)) => Some(*number),
            _ => None,
        }
    }

    /// The whole number given, or its fixed default.
    pub fn whole(&self, key: Named) -> i64 {
        match (self.whole_given(key), key.key.absent) {
            (Some(number), _) | (None, Absent::Whole(number)) => number,
            _ => 0,
        }
    }

    /// The whole number given.
    pub(crate) fn whole_given(&self, key: Named) -> Option<i64> {
        match self.given(key) {
            Some(Value::Whole(number)) => Some(*number),
            _ => None,
        }
    }

    /// The switch given, or its default.
    pub fn switch(&self, key: Named) -> bool {
        match (self.given(key), key.key.absent) {
            (Some(Value::Switch(on)), _) => *on,
            (None, Absent::Switch(on)) => on,
            _ => false,
        }
    }

    /// The word or text given, or its default.
    pub fn text(&self, key: Named) -> &str {
        match (self.given(key), key.key.absent) {
            (Some(Value::Text(text)), _) => text,
            (None, Absent::Word(word)) => word,
            _ => "",
        }
    }

    /// The numbers given (rows one after the other), or their fixed default.
    pub fn numbers(&self, key: Named) -> Vec<f64> {
        match (self.numbers_given(key), key.key.absent) {
            (Some(numbers), _) | (None, Absent::Numbers(numbers)) => numbers.to_vec(),
            _ => Vec::new(),
        }
    }

    /// The numbers given, rows one after the other.
    pub(crate) fn numbers_given(&self, key: Named) -> Option<&[f64]> {
        match self.given(key) {
            Some(Value::Numbers(numbers)) => Some(numbers),
            _ => None,
        }
    }

    /// Takes the sub-table out; an empty one of defaults if it is absent.
    pub(crate) fn take_table(&mut self, key: Named, section: &'static Section) -> Values {
        match self.found.remove(self.own(key)) {
            Some((Value::Table(table), _)) => table,
            _ => Values::absent(section, section.title, self.at.clone()),
        }
    }

    /// Takes the list of sub-tables out; empty if it is absent.
    pub(crate) fn take_tables(&mut self, key: Named) -> Vec<Values> {
        match self.found.remove(self.own(key)) {
            Some((Value::Tables(tables), _)) => tables,
            _ => Vec::new(),
        }
    }
}

fn number(value: &DeValue<'_>) -> Option<f64> {
    match value {
        // A decimal point is optional; digits that i64 holds are far more than a length needs.
        DeValue::Integer(digits) => i64::from_str_radix(digits.as_str(), digits.radix())
            .ok()
            .map(|whole| whole as f64),
        DeValue::Float(digits) => digits.as_str().parse().ok(),
        _ => None,
    }
}

fn numbers(value: &DeValue<'_>) -> Option<Vec<f64>> {
    let array = value.as_array()?;
    array
        .iter()
        .map(|element| number(element.get_ref()))
        .collect()
}

fn rows_of(value: &DeValue<'_>, rows: usize, columns: usize) -> Result<Value, String> {
    let wanted = format!("{rows} rows of {columns} numbers, [[...], ...]");
    let Some(array) = value.as_array() else {
        return Err(wrong_kind(&wanted, value));
    };
    let lists: Option<Vec<Vec<f64>>> = array.iter().map(|row| numbers(row.get_ref())).collect();
    match lists {
        Some(lists) if lists.len() == rows && lists.iter().all(|row| row.len() == columns) => {
            let flat: Vec<f64> = lists.into_iter().flatten().collect();
            match flat.iter().find(|number| !Range::Finite.contains(**number)) {
                Some(bad) => Err(format!("must hold only {NUMBERS}, not {bad}")),
                None => Ok(Value::Numbers(flat)),
            }
        }
        _ => Err(format!("must hold {wanted}")),
    }
}

fn wrong_kind(wanted: &str, value: &DeValue<'_>) -> String {
    let article = if value.is_integer() || value.is_array() {
        "an"
    } else {
        "a"
    };
    format!("must be {wanted}, not {article} {}", value.type_str())
}

fn alternatives(words: &[&str]) -> String {
    let quoted: Vec<String> = words.iter().map(|word| format!("\"{word}\"")).collect();
    quoted.join(" or ")
}

/// Message and help for an unknown key: the nearest known one, or the section it belongs to.
fn unknown(name: &str, section: &'static Section) -> (String, String) {
    let what = format!("unknown key `{name}` in {}", section.title);
    let keys = section.keys.iter().map(|key| key.name);
    if let Some(known) = nearest(name, keys) {
        return (what, format!("did you mean `{known}`?"));
    }
    if let Some(home) = SECTIONS.iter().find(|section| section.key(name).is_some()) {
        return (what, format!("`{name}` belongs in {}", home.title));
    }
    let known: Vec<&str> = section.keys.iter().map(|key| key.name).collect();
    (what, format!("the keys known here: {}", known.join(", ")))
}
