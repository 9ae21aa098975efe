//! The keys of the robot file as a JSON schema, for editors.

use super::schema::{Absent, Key, Kind, ROBOT, Range, Section};
use serde_json::{Map, Value, json};

/// JSON schema (draft 2020-12) of the robot file, made from the table that the parser uses.
///
/// ```
/// let schema = mcdpr_core::robot::json_schema();
/// let platform = &schema["properties"]["platform"]["properties"];
/// assert_eq!(platform["mass_kg"]["default"], 1.4);
/// assert_eq!(schema["required"], serde_json::json!(["name", "cable"]));
/// ```
#[must_use]
pub fn json_schema() -> Value {
    let mut schema = section(&ROBOT);
    schema["$schema"] = json!("https://json-schema.org/draft/2020-12/schema");
    schema["title"] = json!("MCDPR robot file");
    schema
}

fn section(section: &Section) -> Value {
    let properties: Map<_, _> = section
        .keys
        .iter()
        .map(|key| (key.name.to_owned(), property(key)))
        .collect();
    let required = section
        .keys
        .iter()
        .filter(|key| matches!(key.absent, Absent::Required))
        .map(|key| key.name);
    json!({
        "type": "object",
        "properties": properties,
        "required": required.collect::<Vec<_>>(),
        "additionalProperties": false,
    })
}

fn property(key: &Key) -> Value {
    let mut value = kind(key.kind);
    let meaning = match key.absent {
        Absent::Follows(rule) => format!("{}. Without it: {rule}.", key.meaning),
        _ => key.meaning.to_owned(),
    };
    value["description"] = json!(meaning);
    match key.absent {
        Absent::Required | Absent::Follows(_) => {}
        Absent::Number(number) => value["default"] = json!(number),
        Absent::Numbers(numbers) => value["default"] = json!(numbers),
        Absent::Whole(number) => value["default"] = json!(number),
        Absent::Word(word) => value["default"] = json!(word),
        Absent::Switch(on) => value["default"] = json!(on),
    }
    value
}

fn number(range: Range) -> Value {
    match range {
        Range::Finite => json!({ "type": "number", "minimum": -1e9, "maximum": 1e9 }),
        Range::Positive => json!({ "type": "number", "minimum": 1e-12, "maximum": 1e9 }),
        Range::NonNegative => json!({ "type": "number", "minimum": 0, "maximum": 1e9 }),
        Range::Fraction => json!({ "type": "number", "minimum": 0, "exclusiveMaximum": 1 }),
        Range::Within(low, high) => json!({ "type": "number", "minimum": low, "maximum": high }),
    }
}

fn kind(kind: Kind) -> Value {
    match kind {
        Kind::Text => json!({ "type": "string", "minLength": 1 }),
        Kind::Word(words) => json!({ "enum": words }),
        Kind::Switch => json!({ "type": "boolean" }),
        Kind::Whole(low, high) => json!({ "type": "integer", "minimum": low, "maximum": high }),
        Kind::Number(range) => number(range),
        Kind::List(counts, range) => {
            let one = |count: &usize| json!({ "minItems": count, "maxItems": count });
            let lengths: Vec<_> = counts.iter().map(one).collect();
            json!({ "type": "array", "items": number(range), "anyOf": lengths })
        }
        Kind::Rows(rows, columns) => {
            let row = json!({
                "type": "array", "items": { "type": "number" },
                "minItems": columns, "maxItems": columns,
            });
            json!({ "type": "array", "items": row, "minItems": rows, "maxItems": rows })
        }
        Kind::Table(inner) => section(inner),
        Kind::Common(inner) => {
            let mut common = section(inner);
            common["required"] = json!([]);
            common
        }
        Kind::Tables(inner) => json!({ "type": "array", "items": section(inner), "minItems": 1 }),
    }
}
