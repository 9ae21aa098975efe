//! Plain tables for people.

/// Lays out rows in columns: the first to the left, the others to the right.
pub(crate) fn lay_out(rows: &[Vec<String>]) -> String {
    let columns = rows.iter().map(Vec::len).max().unwrap_or(0);
    let widths: Vec<_> = (0..columns)
        .map(|column| {
            let cells = rows.iter().filter_map(|row| row.get(column));
            cells.map(|cell| cell.chars().count()).max().unwrap_or(0)
        })
        .collect();
    let mut text = String::new();
    for row in rows {
        let mut line = String::new();
        for (column, (cell, width)) in row.iter().zip(&widths).enumerate() {
            let pad = " ".repeat(width - cell.chars().count());
            if column == 0 {
                line = format!("{cell}{pad}");
            } else {
                line = format!("{line}   {pad}{cell}");
            }
        }
        text.push_str(line.trim_end());
        text.push('\n');
    }
    text
}

#[cfg(test)]
mod tests {
    use super::lay_out;

    #[test]
    fn columns_line_up() {
        let rows = [["a", "1", "22"], ["bcd", "333", "4"]];
        let rows: Vec<Vec<String>> = rows.map(|r| r.map(str::to_owned).to_vec()).to_vec();
        assert_eq!(lay_out(&rows), "a       1   22\nbcd   333    4\n");
    }
}
