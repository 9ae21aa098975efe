//! Other values in a robot file.

use crate::failure::Failure;

/// Puts a value where a dotted key says; a number in it counts entries of a list from 1.
pub(crate) fn set(table: &mut toml::Table, key: &str, value: toml::Value) -> Result<(), Failure> {
    let wrong = |what: &str| Failure::input(format!("{key}: {what}"));
    let (path, last) = key.rsplit_once('.').unwrap_or(("", key));
    let mut place = table;
    let mut parts = path.split('.').filter(|part| !part.is_empty()).peekable();
    while let Some(part) = parts.next() {
        let number = parts.peek().and_then(|next| next.parse::<usize>().ok());
        let inner = place
            .entry(part)
            .or_insert_with(|| toml::Value::Table(toml::Table::new()));
        place = match (inner, number) {
            (toml::Value::Table(inner), None) => inner,
            (toml::Value::Array(entries), Some(number)) => {
                parts.next();
                let count = entries.len();
                let entry = number
                    .checked_sub(1)
                    .and_then(|index| entries.get_mut(index));
                match entry {
                    Some(toml::Value::Table(inner)) => inner,
                    _ => {
                        return Err(wrong(&format!("there is no {part} {number}: 1 to {count}")));
                    }
                }
            }
            (toml::Value::Array(_), None) => {
                return Err(wrong(&format!("name one of the list, such as {part}.1")));
            }
            _ => return Err(wrong(&format!("{part} is not a table of the robot file"))),
        };
    }
    place.insert(last.to_owned(), value);
    Ok(())
}
