//! Tables as HTML.

use super::{Alignment, Table};
use crate::report::escaped;

impl Table {
    /// The table as an element of a page.
    pub fn html(&self) -> String {
        let row = |cells: &Vec<String>, tag: &str| {
            let cells = cells.iter().zip(&self.alignment).map(|(cell, side)| {
                let class = match side {
                    Alignment::Left => "",
                    Alignment::Right => " class=\"number\"",
                };
                format!("<{tag}{class}>{}</{tag}>", escaped(cell))
            });
            format!("<tr>{}</tr>", cells.collect::<String>())
        };
        let rows = self.rows.iter().map(|cells| row(cells, "td"));
        let (head, rows) = (
            row(&self.headers, "th"),
            rows.collect::<Vec<_>>().join("\n"),
        );
        format!("<table>\n<thead>{head}</thead>\n<tbody>\n{rows}\n</tbody>\n</table>")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_are_text() {
        let table = Table::new(["a", "n"], 1, [vec!["<b>&".to_owned(), "1".to_owned()]]);
        assert_eq!(
            table.html(),
            "<table>\n<thead><tr><th>a</th><th class=\"number\">n</th></tr></thead>\n<tbody>\n\
             <tr><td>&lt;b&gt;&amp;</td><td class=\"number\">1</td></tr>\n</tbody>\n</table>"
        );
    }
}
