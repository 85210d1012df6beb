//! The page around the data: markup, styles and scripts from the files in `assets/`.

use crate::report::{escaped, visible_line};

/// The markup, with placeholders in double braces.
const MARKUP: &str = include_str!("assets/page.html");
/// The markup of a page without views, and how it finds the reader's theme.
const DOCUMENT: &str = include_str!("assets/document.html");
/// Colors and type, and the styles of tables: those of a page without views too.
const THEME: &str = include_str!("assets/theme.css");
const OVERVIEW: &str = include_str!("assets/overview.css");
/// Styles, in order.
const STYLES: [&str; 5] = [
    THEME,
    OVERVIEW,
    include_str!("assets/scenarios.css"),
    include_str!("assets/scene.css"),
    include_str!("assets/transcript.css"),
];
/// Scripts, in order: later ones use earlier ones.
const SCRIPTS: [&str; 22] = [
    include_str!("assets/dom.js"),
    include_str!("assets/data.js"),
    include_str!("assets/moment.js"),
    include_str!("assets/decision.js"),
    include_str!("assets/names.js"),
    include_str!("assets/charts.js"),
    include_str!("assets/comparison.js"),
    include_str!("assets/overview.js"),
    include_str!("assets/histograms.js"),
    include_str!("assets/player.js"),
    include_str!("assets/controls.js"),
    include_str!("assets/score_labels.js"),
    include_str!("assets/bev.js"),
    include_str!("assets/legend.js"),
    include_str!("assets/thumbnails.js"),
    include_str!("assets/scenario_list.js"),
    include_str!("assets/series.js"),
    include_str!("assets/transcript.js"),
    include_str!("assets/latency.js"),
    include_str!("assets/scenarios.js"),
    include_str!("assets/live.js"),
    include_str!("assets/main.js"),
];

/// Size without the data, bytes.
pub(super) fn size() -> usize {
    MARKUP.len() + STYLES.concat().len() + SCRIPTS.concat().len()
}

/// The page; `data` is markup.
pub(super) fn page(title: &str, data: &str) -> String {
    let (title, style, script) = (
        escaped(&visible_line(title)),
        STYLES.concat(),
        SCRIPTS.concat(),
    );
    let parts = [
        ("{{title}}", title.as_str()),
        ("{{style}}", &style),
        ("{{data}}", data),
        ("{{script}}", &script),
    ];
    filled(MARKUP, &parts)
}

/// A page of the same look without views; `body` is markup.
pub(super) fn document(title: &str, body: &str) -> String {
    let (title, style) = (escaped(&visible_line(title)), [THEME, OVERVIEW].concat());
    let parts = [
        ("{{title}}", title.as_str()),
        ("{{style}}", &style),
        ("{{body}}", body),
    ];
    filled(DOCUMENT, &parts)
}

/// A markup with its placeholders filled, in the order in which it has them.
fn filled(markup: &str, parts: &[(&str, &str)]) -> String {
    // Placeholders are looked for in the markup alone: a title or the data may have the same words.
    let (mut page, mut rest) = (String::new(), markup);
    for &(place, text) in parts {
        if let Some((before, after)) = rest.split_once(place) {
            page.push_str(before);
            page.push_str(text);
            rest = after;
        }
    }
    page + rest
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_requests_nothing_else() {
        let page = page("runs & <more>", "<script id=\"x\">{{script}}</script>");
        assert!(
            page.contains("<title>runs &amp; &lt;more&gt;</title>")
                && page.contains("id=\"x\">{{script}}<")
        );
        assert!(!page.contains("{{style}}") && !page.contains("{{data}}"));
        // The namespace of SVG is a name that no browser requests.
        let page = page.replace("http://www.w3.org/2000/svg", "");
        for word in ["http:", "https:", "@import", "url(", "src=\"", "eval("] {
            assert!(!page.contains(word), "the page has {word}");
        }
        assert_eq!(
            SCRIPTS
                .iter()
                .filter(|script| script.contains("</script"))
                .count(),
            0
        );
    }

    #[test]
    fn a_document_has_its_parts_and_requests_nothing() {
        let page = document("a < b", "<h2>{{style}}</h2>");
        assert!(page.contains("<title>a &lt; b</title>") && page.contains("<h2>{{style}}</h2>"));
        assert!(page.contains("--paper:") && !page.contains("{{body}}"));
        for word in ["http:", "https:", "@import", "url(", "src=\"", "eval("] {
            assert!(!page.contains(word), "the page has {word}");
        }
    }

    #[test]
    fn a_title_may_look_like_a_placeholder() {
        for title in ["{{data}}", "{{style}} {{script}} {{title}}"] {
            let page = page(title, "<i>the data</i>");
            assert!(
                page.contains(&format!("<title>{title}</title>"))
                    && page.matches("<i>the data</i>").count() == 1
            );
            assert!(page.contains(SCRIPTS[0]) && page.contains(STYLES[0]));
        }
    }

    #[test]
    fn files_of_the_page_stay_readable() {
        for file in SCRIPTS.iter().chain(&STYLES) {
            assert!(
                file.lines().count() < 400,
                "{}",
                file.lines().next().unwrap_or_default()
            );
        }
    }
}
