//! Names that were probably meant.

/// The known name that is nearest to a mistyped one, if it is near enough.
pub(crate) fn nearest<'a>(name: &str, known: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let near = known
        .into_iter()
        .map(|known| (distance(name, known), known));
    let near = near.filter(|(steps, known)| {
        // Two typing errors, or one in four characters of a long name.
        *steps <= 2.max(known.len() / 4)
            || (name.len() > 2 && (known.starts_with(name) || name.starts_with(known)))
    });
    near.min().map(|(_, known)| known)
}

/// Levenshtein distance: insertions, deletions and replacements of one character.
fn distance(a: &str, b: &str) -> usize {
    let b: Vec<char> = b.chars().collect();
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, letter) in a.chars().enumerate() {
        let mut diagonal = i;
        let mut left = i + 1;
        for (slot, other) in row.iter_mut().skip(1).zip(&b) {
            let replaced = diagonal + usize::from(letter != *other);
            diagonal = *slot;
            left = replaced.min(left + 1).min(diagonal + 1);
            *slot = left;
        }
        if let Some(first) = row.first_mut() {
            *first = i + 1;
        }
    }
    row.last().copied().unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::{distance, nearest};

    #[test]
    fn distance_counts_single_character_edits() {
        for (a, b, steps) in [
            ("", "", 0),
            ("", "abc", 3),
            ("abc", "", 3),
            ("kitten", "sitting", 3),
            ("anchor_m", "anchor_mm", 1),
            ("flaw", "lawn", 2),
        ] {
            assert_eq!(distance(a, b), steps, "{a} {b}");
        }
    }
    #[test]
    fn a_mistyped_name_is_recognised_and_a_strange_one_is_not() {
        let known = ["paper-table5", "lab-fast", "lab-direct"];
        assert_eq!(nearest("lab-fst", known), Some("lab-fast"));
        assert_eq!(nearest("lab", known), Some("lab-fast"));
        assert_eq!(nearest("my-robot.toml", known), None);
    }
}
