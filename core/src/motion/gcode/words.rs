//! The words of a line of G-code.

/// One letter with its number.
#[derive(Debug, Clone, Copy)]
pub(super) struct Word {
    pub letter: char,
    pub value: f64,
    pub column: usize,
}

/// Column, from 1, and what is wrong there.
pub(super) type Wrong = (usize, String);

/// Words of a line, without its comments.
pub(super) fn words(line: &str) -> Result<Vec<Word>, Wrong> {
    let letters: Vec<char> = line.chars().collect();
    let mut words = Vec::new();
    let mut at = 0;
    while let Some(&letter) = letters.get(at) {
        let column = at + 1;
        at += 1;
        match letter {
            ';' => break,
            // The mark at the start and end of a program tape.
            '%' if words.is_empty() => break,
            '(' => {
                let end = letters.iter().skip(at).position(|&c| c == ')');
                let end = end.ok_or((column, "this comment has no end".to_owned()))?;
                at += end + 1;
            }
            c if c.is_whitespace() => {}
            c if c.is_ascii_alphabetic() => {
                while letters.get(at).is_some_and(|c| c.is_whitespace()) {
                    at += 1;
                }
                let number: String = letters
                    .iter()
                    .skip(at)
                    .take_while(|c| c.is_ascii_digit() || matches!(c, '+' | '-' | '.'))
                    .collect();
                let value: f64 = number.parse().map_err(|_| {
                    let there = letters.iter().skip(at).take_while(|c| !c.is_whitespace());
                    let there: String = there.take(12).collect();
                    let shown = if there.is_empty() { "nothing" } else { &there };
                    (at + 1, format!("{c} needs a number, there is {shown}"))
                })?;
                if !value.is_finite() {
                    return Err((at + 1, format!("{c}{number} is not a finite number")));
                }
                words.push(Word {
                    letter: c.to_ascii_uppercase(),
                    value,
                    column,
                });
                at += number.chars().count();
            }
            other => return Err((column, format!("{other:?} has no meaning here"))),
        }
    }
    Ok(words)
}
