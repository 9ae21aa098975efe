//! Records protected against changes: a SHA-256 of the record's text, keyed (HMAC, RFC 2104) if
//! there is a key.

use miette::Diagnostic;
use serde_json::{Map, Value, json};
use sha2::{Digest, Sha256};
use thiserror::Error;

/// Bytes of a block of SHA-256.
const BLOCK: usize = 64;

/// Why a record cannot be trusted.
#[derive(Debug, Error, Diagnostic)]
pub(crate) enum SealError {
    /// It is not a record.
    #[error("this is not a record of `mcdpr bench`: {reason}")]
    #[diagnostic(
        code(mcdpr::bench::record),
        help("give the file that `mcdpr bench --out FILE` wrote")
    )]
    NoRecord {
        /// What is missing.
        reason: String,
    },
    /// Text and seal do not match.
    #[error("the record was changed after it was sealed, or sealed with another key")]
    #[diagnostic(
        code(mcdpr::bench::seal),
        help(
            "do not use this board by it: run `mcdpr bench` again, or give the right key with --key FILE"
        )
    )]
    Broken,
}

fn digest(parts: &[&[u8]]) -> [u8; 32] {
    let mut hash = Sha256::new();
    for part in parts {
        hash.update(part);
    }
    hash.finalize().into()
}

fn hmac(key: &[u8], text: &[u8]) -> [u8; 32] {
    let mut block = [0; BLOCK];
    // RFC 2104: a longer key is replaced by its hash, a shorter one is padded with zeros.
    if key.len() > BLOCK {
        block[..32].copy_from_slice(&digest(&[key]));
    } else {
        block[..key.len()].copy_from_slice(key);
    }
    let inner = digest(&[&block.map(|byte| byte ^ 0x36), text]);
    digest(&[&block.map(|byte| byte ^ 0x5C), &inner])
}

fn words(record: &Map<String, Value>, key: Option<&[u8]>) -> (&'static str, String) {
    // Members of a map are in the order of their names: one record has one text.
    let text = Value::Object(record.clone()).to_string();
    let (algorithm, bytes) = match key {
        Some(key) => ("hmac-sha256", hmac(key, text.as_bytes())),
        None => ("sha256", digest(&[text.as_bytes()])),
    };
    let hex = bytes.iter().map(|byte| format!("{byte:02x}")).collect();
    (algorithm, hex)
}

/// SHA-256 of bytes, in hexadecimal digits.
#[must_use]
pub(crate) fn sha256(bytes: &[u8]) -> String {
    digest(&[bytes])
        .iter()
        .map(|byte| format!("{byte:02x}"))
        .collect()
}

/// Adds the member `seal` to a record.
#[must_use]
pub(crate) fn seal(mut record: Map<String, Value>, key: Option<&[u8]>) -> Value {
    record.remove("seal");
    let (algorithm, value) = words(&record, key);
    record.insert(
        "seal".into(),
        json!({ "algorithm": algorithm, "value": value }),
    );
    Value::Object(record)
}

/// Checks that a record matches its seal; returns its verdict.
///
/// # Errors
/// [`SealError`].
pub(crate) fn verify(text: &str, key: Option<&[u8]>) -> Result<String, SealError> {
    let no_record = |reason: &str| SealError::NoRecord {
        reason: reason.to_owned(),
    };
    let value: Value = serde_json::from_str(text).map_err(|error| no_record(&error.to_string()))?;
    let Value::Object(mut record) = value else {
        return Err(no_record("no JSON object"));
    };
    let seal = record.remove("seal").ok_or_else(|| no_record("no seal"))?;
    let (algorithm, value) = words(&record, key);
    if seal["algorithm"] != algorithm || seal["value"] != value {
        return Err(SealError::Broken);
    }
    let verdict = record.get("verdict").and_then(Value::as_str);
    verdict
        .map(str::to_owned)
        .ok_or_else(|| no_record("no verdict"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hashes_are_those_of_the_standards() {
        // FIPS 180-4, "abc"; RFC 4231, test case 2.
        assert_eq!(
            sha256(b"abc"),
            "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
        );
        let keyed = hmac(b"Jefe", b"what do ya want for nothing?");
        let hex: String = keyed.iter().map(|byte| format!("{byte:02x}")).collect();
        assert_eq!(
            hex,
            "5bdcc146bf60754e6a042426089575c75a003f089d2739839dec58b964ec3843"
        );
    }

    #[test]
    fn a_changed_record_is_reported_and_so_is_another_key() {
        let Value::Object(record) = json!({ "verdict": "fail", "serial": "01" }) else {
            panic!("an object")
        };
        for key in [None, Some(&b"secret"[..])] {
            let text = seal(record.clone(), key).to_string();
            assert_eq!(verify(&text, key).unwrap(), "fail");
            assert!(matches!(
                verify(&text.replace("fail", "pass"), key),
                Err(SealError::Broken)
            ));
            assert!(matches!(
                verify(&text, Some(b"other")),
                Err(SealError::Broken)
            ));
        }
        assert!(matches!(
            verify("{}", None),
            Err(SealError::NoRecord { .. })
        ));
        assert!(matches!(
            verify("no", None),
            Err(SealError::NoRecord { .. })
        ));
    }
}
