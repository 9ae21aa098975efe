//! Lists of one entry per cable in JSON, read and written without allocation.

use mcdpr_kinematics::{CableVec, MAX_CABLES};
use serde::de::{Error, MapAccess, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::fmt;

/// A list with at most [`MAX_CABLES`] entries.
#[derive(Debug, Clone, Copy)]
pub(crate) struct List<T>(pub(crate) CableVec<T>);

impl<T: Serialize> Serialize for List<T> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_seq(self.0.iter())
    }
}

impl<'de, T: Deserialize<'de> + Copy + Default> Deserialize<'de> for List<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Entries<T>(std::marker::PhantomData<T>);
        impl<'de, T: Deserialize<'de> + Copy + Default> Visitor<'de> for Entries<T> {
            type Value = List<T>;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                write!(f, "a list with one number per cable")
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut from: A) -> Result<List<T>, A::Error> {
                let mut items = [T::default(); MAX_CABLES];
                let mut count = 0;
                while let Some(value) = from.next_element()? {
                    *items.get_mut(count).ok_or_else(|| {
                        Error::custom(format!("more than {MAX_CABLES} entries in a list"))
                    })? = value;
                    count += 1;
                }
                let used = items.get(..count).unwrap_or_default();
                Ok(List(CableVec::from_fn(count, |i| {
                    used.get(i).copied().unwrap_or_default()
                })))
            }
        }
        deserializer.deserialize_seq(Entries(std::marker::PhantomData))
    }
}

/// `{"4": 10.0}`: tensions by cable number from 1.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct ByCable {
    /// Tension of each cable that is named, N; index 0 is cable 1.
    pub(crate) tensions_n: [Option<f64>; MAX_CABLES],
}

impl<'de> Deserialize<'de> for ByCable {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Entries;
        impl<'de> Visitor<'de> for Entries {
            type Value = ByCable;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                write!(f, "tensions by cable number, such as {{\"4\": 10.0}}")
            }

            fn visit_map<A: MapAccess<'de>>(self, mut from: A) -> Result<ByCable, A::Error> {
                let mut out = ByCable::default();
                while let Some(CableNumber(index)) = from.next_key()? {
                    let entry = out.tensions_n.get_mut(index);
                    match entry {
                        Some(entry @ None) => *entry = Some(from.next_value()?),
                        _ => {
                            return Err(Error::custom(format!(
                                "cable {}: its tension is given twice",
                                index + 1
                            )));
                        }
                    }
                }
                Ok(out)
            }
        }
        deserializer.deserialize_map(Entries)
    }
}

/// A cable number as the key of an object, kept as an index from 0.
struct CableNumber(usize);

impl<'de> Deserialize<'de> for CableNumber {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Key;
        impl Visitor<'_> for Key {
            type Value = CableNumber;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                write!(f, "a cable number such as \"4\"")
            }

            fn visit_str<E: Error>(self, text: &str) -> Result<CableNumber, E> {
                match text.parse::<usize>() {
                    Ok(number @ 1..=MAX_CABLES) => Ok(CableNumber(number - 1)),
                    _ => Err(E::custom(format!(
                        "`{text}` is not a cable number: cables are counted from 1"
                    ))),
                }
            }
        }
        deserializer.deserialize_str(Key)
    }
}

#[cfg(test)]
mod tests {
    use super::{ByCable, List};

    #[test]
    fn lists_keep_their_length_and_their_gaps() {
        let list: List<Option<f64>> = serde_json::from_str("[1, null, 2.5]").unwrap();
        assert_eq!(&list.0[..], &[Some(1.0), None, Some(2.5)]);
        assert_eq!(serde_json::to_string(&list).unwrap(), "[1.0,null,2.5]");
        let long = format!("[{}1]", "1,".repeat(16));
        assert!(serde_json::from_str::<List<f64>>(&long).is_err());
    }

    #[test]
    fn tensions_are_by_cable_number() {
        let by: ByCable = serde_json::from_str(r#"{"4": 10, "1": 2.5}"#).unwrap();
        assert_eq!(by.tensions_n[3], Some(10.0));
        assert_eq!(by.tensions_n[0], Some(2.5));
        assert_eq!(by.tensions_n[1], None);
        for bad in [
            r#"{"0": 1}"#,
            r#"{"17": 1}"#,
            r#"{"a": 1}"#,
            r#"{"4": 1, "4": 2}"#,
            "[1]",
        ] {
            assert!(serde_json::from_str::<ByCable>(bad).is_err(), "{bad}");
        }
    }
}
