//! Reads a netlist in KiCad's text format: parts, the pins of each kind of part, and nets.

use std::collections::BTreeMap;

/// A pin of a kind of part.
pub(crate) struct Pin {
    pub(crate) number: String,
    /// Empty where the pin has a number only.
    pub(crate) name: String,
    /// KiCad's electrical type: `passive`, `input`, `power_in` and so on.
    pub(crate) electrical: String,
}

pub(crate) struct Part {
    pub(crate) reference: String,
    pub(crate) value: String,
    pub(crate) description: String,
    /// Key of [`Netlist::kinds`].
    pub(crate) kind: String,
}

pub(crate) struct Netlist {
    pub(crate) parts: Vec<Part>,
    pub(crate) kinds: BTreeMap<String, Vec<Pin>>,
    /// The net of each connected pin, by reference and number.
    nets: BTreeMap<(String, String), String>,
}

impl Netlist {
    /// Reads the text.
    ///
    /// # Errors
    /// A list that is not closed, a field that is missing, a node whose part or pin is unknown, or a pin in two nets.
    pub(crate) fn read(text: &str) -> Result<Self, String> {
        let all = List::read(text)?;
        let mut kinds = BTreeMap::new();
        for kind in all.list("libparts")?.lists("libpart") {
            let pins = kind.list("pins")?.lists("pin").map(pin);
            let pins = pins.collect::<Result<Vec<_>, _>>()?;
            kinds.insert(kind.text("part")?, pins);
        }
        let parts = all.list("components")?.lists("comp").map(part);
        let mut read = Self {
            parts: parts.collect::<Result<_, _>>()?,
            kinds,
            nets: BTreeMap::new(),
        };
        for net in all.list("nets")?.lists("net") {
            let name = net.text("name")?;
            for node in net.lists("node") {
                read.connect(&name, node)?;
            }
        }
        Ok(read)
    }

    fn connect(&mut self, net: &str, node: &List) -> Result<(), String> {
        let (reference, number) = (node.text("ref")?, node.text("pin")?);
        let part = self.parts.iter().find(|part| part.reference == reference);
        let part =
            part.ok_or_else(|| format!("net {net}: {reference} is not among the components"))?;
        let mut pins = self.pins(part)?.iter();
        let pin = pins.find(|pin| pin.number == number);
        let pin = pin.ok_or_else(|| {
            let kind = &part.kind;
            format!("net {net}: {reference} has no pin {number}; add it to the libpart {kind}")
        })?;
        let name = node.text("pinfunction").unwrap_or_default();
        if name != pin.name {
            let known = &pin.name;
            return Err(format!(
                "net {net}: pin {number} of {reference} is named {name:?}, in its libpart {known:?}"
            ));
        }
        let key = (reference, number);
        match self.nets.get(&key) {
            Some(other) => Err(format!(
                "pin {} of {} is in the nets {other} and {net}",
                key.1, key.0
            )),
            None => {
                self.nets.insert(key, net.to_owned());
                Ok(())
            }
        }
    }

    /// The pins of a part.
    ///
    /// # Errors
    /// If its kind is not among the `libparts`.
    pub(crate) fn pins(&self, part: &Part) -> Result<&[Pin], String> {
        let pins = self.kinds.get(&part.kind).map(Vec::as_slice);
        pins.ok_or_else(|| {
            format!(
                "{}: there is no libpart named {}",
                part.reference, part.kind
            )
        })
    }

    /// The net of a pin; none where it is left open.
    pub(crate) fn net(&self, reference: &str, number: &str) -> Option<&str> {
        let key = (reference.to_owned(), number.to_owned());
        self.nets.get(&key).map(String::as_str)
    }

    /// Nets that supply a pin but have no pin that is a supply: KiCad's check wants a flag on them.
    pub(crate) fn without_source(&self) -> Result<Vec<String>, String> {
        let mut sourced = BTreeMap::new();
        for part in &self.parts {
            for pin in self.pins(part)? {
                let net = self.net(&part.reference, &pin.number);
                match (net, pin.electrical.as_str()) {
                    (Some(net), "power_in") => _ = sourced.entry(net).or_insert(false),
                    (Some(net), "power_out") => _ = sourced.insert(net, true),
                    _ => {}
                }
            }
        }
        let open = sourced.into_iter().filter(|(_, sourced)| !sourced);
        Ok(open.map(|(net, _)| net.to_owned()).collect())
    }
}

fn pin(pin: &List) -> Result<Pin, String> {
    Ok(Pin {
        number: pin.text("num")?,
        name: pin.text("name")?,
        electrical: pin.text("type")?,
    })
}

fn part(part: &List) -> Result<Part, String> {
    Ok(Part {
        reference: part.text("ref")?,
        value: part.text("value")?,
        description: part.text("description")?,
        kind: part.list("libsource")?.text("part")?,
    })
}

/// A list of the file: `(name "text" (other ...))`.
struct List {
    name: String,
    /// Words and texts after the name.
    texts: Vec<String>,
    lists: Vec<List>,
}

impl List {
    fn read(text: &str) -> Result<Self, String> {
        let mut rest = text.trim_start();
        let list = Self::next(&mut rest)?;
        match rest.trim() {
            "" => Ok(list),
            more => Err(format!("the netlist goes on after its end: {more:.40}")),
        }
    }

    /// Reads the list at the start of `rest`, and moves `rest` behind it.
    fn next(rest: &mut &str) -> Result<Self, String> {
        let inner = rest.strip_prefix('(');
        *rest = inner.ok_or_else(|| format!("the netlist has no list at: {rest:.40}"))?;
        let mut words = Vec::new();
        let mut lists = Vec::new();
        loop {
            *rest = rest.trim_start();
            if let Some(after) = rest.strip_prefix(')') {
                *rest = after;
                break;
            } else if rest.starts_with('(') {
                lists.push(Self::next(rest)?);
            } else {
                words.push(word(rest)?);
            }
        }
        let mut words = words.into_iter();
        Ok(Self {
            name: words.next().unwrap_or_default(),
            texts: words.collect(),
            lists,
        })
    }

    fn lists<'a>(&'a self, name: &'a str) -> impl Iterator<Item = &'a Self> {
        self.lists.iter().filter(move |list| list.name == name)
    }

    fn list(&self, name: &str) -> Result<&Self, String> {
        let mut found = self.lists.iter().filter(|list| list.name == name);
        found
            .next()
            .ok_or_else(|| format!("a ({} ...) of the netlist has no ({name} ...)", self.name))
    }

    fn text(&self, name: &str) -> Result<String, String> {
        let text = self.list(name)?.texts.first();
        text.cloned()
            .ok_or_else(|| format!("a ({name}) of the netlist has no text"))
    }
}

/// Reads the word or quoted text at the start of `rest`, and moves `rest` behind it.
fn word(rest: &mut &str) -> Result<String, String> {
    let Some(quoted) = rest.strip_prefix('"') else {
        let end = rest.find(|c: char| c.is_whitespace() || c == '(' || c == ')');
        let (word, after) = rest.split_at(end.unwrap_or(rest.len()));
        if word.is_empty() {
            return Err("a list of the netlist is not closed".to_owned());
        }
        *rest = after;
        return Ok(word.to_owned());
    };
    let mut text = String::new();
    let mut chars = quoted.char_indices();
    while let Some((at, c)) = chars.next() {
        match c {
            '"' => {
                *rest = quoted.get(at + 1..).unwrap_or_default();
                return Ok(text);
            }
            '\\' => text.extend(chars.next().map(|(_, c)| c)),
            c => text.push(c),
        }
    }
    Err(format!("a text of the netlist is not closed: {text:.40}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn board(nodes: &str) -> Result<Netlist, String> {
        Netlist::read(&format!(
            r#"(export (components
                (comp (ref "R1") (value "1 \"k\"") (description "") (libsource (lib "b") (part "R"))))
              (libparts (libpart (lib "b") (part "R") (pins
                (pin (num "1") (name "") (type "passive")) (pin (num "2") (name "V") (type "power_in")))))
              (nets (net (name "A") {nodes})))"#
        ))
    }

    #[test]
    fn a_pin_has_its_net_and_an_open_one_has_none() {
        let read = board(r#"(node (ref "R1") (pin "2") (pinfunction "V"))"#).unwrap();
        assert_eq!(read.parts[0].value, "1 \"k\"");
        assert_eq!(read.net("R1", "2"), Some("A"));
        assert_eq!(read.net("R1", "1"), None);
        assert_eq!(read.without_source().unwrap(), ["A"]);
    }

    #[test]
    fn a_wrong_netlist_is_refused_with_what_is_wrong() {
        let one = r#"(node (ref "R1") (pin "1"))"#;
        for (nodes, what) in [
            (r#"(node (ref "R2") (pin "1"))"#, "R2 is not among"),
            (r#"(node (ref "R1") (pin "3"))"#, "has no pin 3"),
            (r#"(node (ref "R1") (pin "2"))"#, "in its libpart \"V\""),
            (&format!("{one} {one}"), "in the nets A and A"),
            (r#"(node (ref "R1)"#, "is not closed"),
            (")))))", "goes on after its end"),
        ] {
            let error = board(nodes).err().unwrap();
            assert!(error.contains(what), "{nodes}: {error}");
        }
    }
}
