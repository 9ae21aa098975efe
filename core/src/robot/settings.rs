//! The values that a robot file states, with what the parser allows and what they mean; and the difference of
//! two files.

use super::schema::{Kind, ROBOT, Range, Section};
use serde::Serialize;
use std::collections::BTreeMap;
use toml::{Table, Value};

/// A value of a robot file.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Setting {
    /// Its key with the tables before it, as in `cable[2].anchor_mm`; tables of a list count from 1. The key
    /// ends with the unit.
    pub key: String,
    /// The value as it is written in a file.
    pub value: String,
    /// What is allowed, in words; empty for texts.
    pub allowed: String,
    /// What the key means; empty if there is no such key.
    pub meaning: &'static str,
}

/// A value that differs between two robot files.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Change {
    /// Its key, as [`Setting::key`].
    pub key: String,
    /// The value of the first file, if it has one.
    pub before: Option<String>,
    /// The value of the second file, if it has one.
    pub after: Option<String>,
    /// What is allowed, in words.
    pub allowed: String,
    /// What the key means.
    pub meaning: &'static str,
}

/// The values that a robot file states, in the order of their keys.
///
/// ```
/// use mcdpr_core::robot::settings;
///
/// let found = settings("name = \"mine\"\n[platform]\nmass_kg = 2.5\n")?;
/// assert_eq!((found[1].key.as_str(), found[1].value.as_str()), ("platform.mass_kg", "2.5"));
/// assert!(found[1].allowed.contains("greater than 0"));
/// # Ok::<(), String>(())
/// ```
///
/// # Errors
/// The text is no TOML: where and why.
pub fn settings(text: &str) -> Result<Vec<Setting>, String> {
    let table: Table = text.parse().map_err(|error| format!("{error}"))?;
    let mut found = Vec::new();
    walk(&table, Some(&ROBOT), "", &mut found);
    Ok(found)
}

/// The values that differ, in the order of their keys.
///
/// # Errors
/// One of the texts is no TOML: where and why.
pub fn changes(before: &str, after: &str) -> Result<Vec<Change>, String> {
    let by_key = |text: &str| -> Result<BTreeMap<String, Setting>, String> {
        let found = settings(text)?.into_iter();
        Ok(found
            .map(|setting| (setting.key.clone(), setting))
            .collect())
    };
    let (before, after) = (by_key(before)?, by_key(after)?);
    let keys: std::collections::BTreeSet<_> = before.keys().chain(after.keys()).collect();
    let changed = keys.into_iter().filter_map(|key| {
        let (old, new) = (before.get(key), after.get(key));
        let known = new.or(old)?;
        let value = |setting: &Setting| setting.value.clone();
        let (old, new) = (old.map(value), new.map(value));
        (old != new).then(|| Change {
            key: key.clone(),
            before: old,
            after: new,
            allowed: known.allowed.clone(),
            meaning: known.meaning,
        })
    });
    Ok(changed.collect())
}

fn walk(table: &Table, section: Option<&Section>, before: &str, found: &mut Vec<Setting>) {
    for (name, value) in table {
        let key = section.and_then(|section| section.key(name));
        let inner = key.and_then(|key| match key.kind {
            Kind::Table(section) | Kind::Tables(section) | Kind::Common(section) => Some(section),
            _ => None,
        });
        let path = format!("{before}{name}");
        match value {
            Value::Table(table) => walk(table, inner, &format!("{path}."), found),
            Value::Array(list) if list.iter().all(Value::is_table) && !list.is_empty() => {
                for (number, table) in (1..).zip(list.iter().filter_map(Value::as_table)) {
                    walk(table, inner, &format!("{path}[{number}]."), found);
                }
            }
            value => found.push(Setting {
                key: path,
                value: value.to_string(),
                allowed: key.map_or_else(String::new, |key| allowed(key.kind)),
                meaning: key.map_or("", |key| key.meaning),
            }),
        }
    }
}

fn allowed(kind: Kind) -> String {
    match kind {
        Kind::Word(words) => words.join(", "),
        Kind::Switch => "true, false".to_owned(),
        Kind::Whole(low, high) => Range::Within(low as f64, high as f64).in_words(),
        Kind::Number(range) => range.in_words(),
        Kind::List(counts, range) => {
            let counts: Vec<String> = counts.iter().map(usize::to_string).collect();
            format!("{} numbers, each {}", counts.join(" or "), range.in_words())
        }
        Kind::Rows(rows, numbers) => format!("{rows} rows of {numbers} numbers"),
        Kind::Text | Kind::Table(_) | Kind::Tables(_) | Kind::Common(_) => String::new(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::BUILT_IN;

    #[test]
    fn every_value_of_every_robot_has_a_meaning() {
        for (name, text) in BUILT_IN {
            let found = settings(text).unwrap();
            assert!(found.len() > 10, "{name}");
            for setting in found {
                assert!(!setting.meaning.is_empty(), "{name}: {}", setting.key);
            }
        }
    }

    #[test]
    fn a_change_has_both_values_and_an_equal_file_has_none() {
        let (_, text) = BUILT_IN[0];
        assert_eq!(
            changes(text, &format!("# a remark\n{text}")),
            Ok(Vec::new())
        );
        let before =
            "name = \"a\"\n[[cable]]\nanchor_mm = [0, 0, 0]\n[[cable]]\nanchor_mm = [1, 0, 0]\n";
        let after = before
            .replace("[1, 0, 0]", "[2, 0, 0]")
            .replace("\"a\"\n", "\"a\"\nnew = 1\n");
        let found = changes(before, &after).unwrap();
        let keys: Vec<_> = found.iter().map(|change| change.key.as_str()).collect();
        assert_eq!(keys, ["cable[2].anchor_mm", "new"]);
        assert_eq!(found[0].before.as_deref(), Some("[1, 0, 0]"));
        assert_eq!(found[0].after.as_deref(), Some("[2, 0, 0]"));
        assert!(
            found[0].allowed.starts_with("3 numbers"),
            "{}",
            found[0].allowed
        );
        assert_eq!((found[1].before.as_deref(), found[1].meaning), (None, ""));
        assert!(changes(before, "name = ").is_err());
    }
}
