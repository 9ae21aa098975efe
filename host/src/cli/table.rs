//! Plain tables and paragraphs for people.

/// Columns of a screen that every table fits.
pub(crate) const COLUMNS: usize = 80;
/// Space between columns where there is room for it, and the least.
const GAPS: [usize; 2] = [3, 2];
/// Columns within which the label of a line must end for its continuation to begin below the text beside it.
const LABEL: usize = 30;

/// Lays out rows in columns: the first to the left, the others to the right. A table that is wider than a screen gets
/// less space between its columns. If that does not help, the first column of each row has a line of its own, and if
/// that does not help either, every cell has one, with the head of its column (from the first row) before it.
pub(crate) fn lay_out(rows: &[Vec<String>]) -> String {
    let fits = |text: &String| text.lines().all(|line| wide(line) <= COLUMNS);
    let beside = GAPS.iter().map(|gap| columns(rows, *gap, false));
    let below = GAPS.iter().map(|gap| columns(rows, *gap, true));
    beside
        .chain(below)
        .find(fits)
        .unwrap_or_else(|| blocks(rows))
}

fn wide(text: &str) -> usize {
    text.chars().count()
}

/// Rows as lines of a table; `folded`: the first cell is a line of its own above the others.
fn columns(rows: &[Vec<String>], gap: usize, folded: bool) -> String {
    let count = rows.iter().map(Vec::len).max().unwrap_or(0);
    let widths: Vec<_> = (0..count)
        .map(|column| {
            let cells = rows.iter().filter_map(|row| row.get(column));
            cells.map(|cell| wide(cell)).max().unwrap_or(0)
        })
        .collect();
    let gap = " ".repeat(gap);
    let mut text = String::new();
    for row in rows {
        let mut line = String::new();
        for (column, (cell, width)) in row.iter().zip(&widths).enumerate() {
            let pad = " ".repeat(width - wide(cell));
            match column {
                0 if folded && cell.is_empty() => {}
                0 if folded => line = format!("{cell}\n"),
                0 => line = format!("{cell}{pad}"),
                _ => line = format!("{line}{gap}{pad}{cell}"),
            }
        }
        text.push_str(line.trim_end());
        text.push('\n');
    }
    text
}

/// Every row as its first cell and, below it, the others with the heads of their columns.
fn blocks(rows: &[Vec<String>]) -> String {
    let Some((heads, rows)) = rows.split_first() else {
        return String::new();
    };
    let width = heads.iter().skip(1).map(|head| wide(head)).max();
    let width = width.unwrap_or(0);
    let mut text = String::new();
    for row in rows {
        text.extend(row.first().map(|label| format!("{label}\n")));
        for (head, cell) in heads.iter().zip(row).skip(1) {
            let pad = " ".repeat(width - wide(head));
            text.push_str(format!("   {head}{pad}   {cell}").trim_end());
            text.push('\n');
        }
    }
    text
}

/// Breaks lines that are wider than a screen between words. A line goes on below its text: below what follows the
/// label if it begins with one (two or more spaces end it), else a little further in than it began.
pub(crate) fn wrap(text: &str, columns: usize) -> String {
    let mut wrapped = String::with_capacity(text.len());
    for line in text.split_inclusive('\n') {
        let (body, end) = match line.strip_suffix('\n') {
            Some(body) => (body, "\n"),
            None => (line, ""),
        };
        if textwrap::core::display_width(body) <= columns {
            wrapped.push_str(line);
            continue;
        }
        let indent = " ".repeat(text_begins(body));
        let options = textwrap::Options::new(columns)
            .subsequent_indent(&indent)
            .break_words(false)
            // At spaces alone: a path or a name with hyphens stays one word.
            .word_separator(textwrap::WordSeparator::AsciiSpace)
            .word_splitter(textwrap::WordSplitter::NoHyphenation)
            .wrap_algorithm(textwrap::WrapAlgorithm::FirstFit);
        wrapped.push_str(&textwrap::fill(body, options));
        wrapped.push_str(end);
    }
    wrapped
}

/// Column in which the text of a line begins, after its label.
fn text_begins(line: &str) -> usize {
    let start = wide(line) - wide(line.trim_start());
    let mut begins = start + 2;
    let mut spaces = 0;
    for (column, letter) in line.chars().enumerate().skip(start).take(LABEL) {
        match letter {
            ' ' => spaces += 1,
            _ if spaces >= 2 => (begins, spaces) = (column, 0),
            _ => spaces = 0,
        }
    }
    begins
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table<const N: usize>(rows: &[[&str; N]]) -> Vec<Vec<String>> {
        let owned = |row: &[&str; N]| row.map(str::to_owned).to_vec();
        rows.iter().map(owned).collect()
    }

    #[test]
    fn columns_line_up() {
        let rows = table(&[["a", "1", "22"], ["bcd", "333", "4"]]);
        assert_eq!(lay_out(&rows), "a       1   22\nbcd   333    4\n");
    }

    #[test]
    fn a_table_fits_a_screen() {
        let name = "n".repeat(60);
        // Less space between the columns.
        let rows = table(&[["what", "123456789", "1234567"], [&name, "1", "2"]]);
        let laid = lay_out(&rows);
        assert_eq!(laid.lines().map(wide).max(), Some(80));
        assert_eq!(laid.lines().count(), 2);
        // The first column on a line of its own.
        let cell = "c".repeat(30);
        let rows = table(&[["", "one", "two"], [&name, &cell, "2"]]);
        let one = format!("{}one   two", " ".repeat(30));
        let laid = lay_out(&rows);
        assert_eq!(laid, format!("{one}\n{name}\n   {cell}     2\n"));
        // A line for every cell.
        let cell = "c".repeat(40);
        let rows = table(&[["what", "one", "three"], [&name, &cell, &cell]]);
        let laid = lay_out(&rows);
        assert_eq!(
            laid,
            format!("{name}\n   one     {cell}\n   three   {cell}\n")
        );
    }

    #[test]
    fn a_wide_line_goes_on_below_its_text() {
        let line = "ok    port           one two three four five\n";
        assert_eq!(
            wrap(line, 32),
            format!(
                "ok    port           one two\n{}three four\n{}five\n",
                " ".repeat(21),
                " ".repeat(21)
            )
        );
        assert_eq!(wrap("a sentence of words", 12), "a sentence\n  of words");
        assert_eq!(wrap("short\n\n", 12), "short\n\n");
        // A path is not broken: it must stay one word for a click or a copy.
        let path = "folder: runs/20260101-000000-a-long-name/path.svg";
        assert!(wrap(path, 20).contains("runs/20260101-000000-a-long-name/path.svg"));
    }
}
