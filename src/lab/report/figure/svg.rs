//! An SVG picture of lines, points and text.

use planagent_runs::report::{escaped, visible_line};
use std::fmt::Write as _;

/// Colors of the series: blue, orange, green, purple of Okabe and Ito's palette, which color-blind
/// readers can tell apart.
const SERIES: [&str; 4] = ["#0072b2", "#d98200", "#009e73", "#b0558d"];

/// Colors of text, lines and background, in light and dark.
const STYLE: &str = "text{font:12px system-ui,sans-serif;fill:#24292f}.head{font-weight:600}.faint{fill:#6e7781}\
                     .ground{fill:#fff}.rule{stroke:#d0d7de}.axis{stroke:#8c959f}\
                     @media(prefers-color-scheme:dark){text{fill:#e6edf3}.faint{fill:#8d96a0}.ground{fill:#0d1117}\
                     .rule{stroke:#30363d}.axis{stroke:#6e7681}}";

/// Where a text stands relative to its point.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Anchor {
    Start,
    Middle,
    End,
}

/// A picture in progress; pixels, y downwards.
pub(crate) struct Picture {
    width: f64,
    body: String,
}

/// The value range of an axis and its pixels.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Scale {
    values: [f64; 2],
    pixels: [f64; 2],
    /// Value between two ticks.
    step: f64,
}

/// The color of a series.
pub(crate) fn color(series: usize) -> &'static str {
    SERIES
        .get(series % SERIES.len())
        .copied()
        .unwrap_or(SERIES[0])
}

impl Picture {
    pub(crate) fn new(width: f64) -> Self {
        Self {
            width,
            body: String::new(),
        }
    }

    /// The file with this height.
    pub(crate) fn finish(self, height: f64, title: &str) -> String {
        let (width, body) = (self.width, self.body);
        format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width:.0}\" height=\"{height:.0}\" viewBox=\"0 0 {width:.0} \
             {height:.0}\" role=\"img\"><title>{}</title><style>{STYLE}</style><rect class=\"ground\" width=\"100%\" \
             height=\"100%\"/>\n{body}</svg>\n",
            escaped(&visible_line(title))
        )
    }

    fn add(&mut self, element: &str) {
        self.body.push_str(element);
        self.body.push('\n');
    }

    /// A text of a class (`""`, `head` or `faint`).
    pub(crate) fn text(&mut self, [x, y]: [f64; 2], anchor: Anchor, class: &str, text: &str) {
        let anchor = match anchor {
            Anchor::Start => "start",
            Anchor::Middle => "middle",
            Anchor::End => "end",
        };
        let text = escaped(&visible_line(text));
        self.add(&format!("<text x=\"{x:.1}\" y=\"{y:.1}\" text-anchor=\"{anchor}\" class=\"{class}\">{text}</text>"));
    }

    /// A line of a class (`rule` or `axis`).
    pub(crate) fn rule(&mut self, [x1, y1]: [f64; 2], [x2, y2]: [f64; 2], class: &str) {
        self.add(&format!(
            "<line x1=\"{x1:.1}\" y1=\"{y1:.1}\" x2=\"{x2:.1}\" y2=\"{y2:.1}\" class=\"{class}\"/>"
        ));
    }

    /// A line through points in a color; `dashed` for the paper.
    pub(crate) fn line(&mut self, points: &[[f64; 2]], color: &str, dashed: bool) {
        let mut path = String::new();
        for [x, y] in points {
            // Writing to a string cannot fail.
            let _ = write!(path, "{x:.1},{y:.1} ");
        }
        let dash = if dashed {
            " stroke-dasharray=\"4 4\""
        } else {
            ""
        };
        let points = path.trim_end();
        self.add(&format!("<polyline points=\"{points}\" fill=\"none\" stroke=\"{color}\" stroke-width=\"2\"{dash}/>"));
    }

    /// A point; hollow for the paper.
    pub(crate) fn point(&mut self, [x, y]: [f64; 2], color: &str, hollow: bool) {
        let fill = if hollow { "none" } else { color };
        self.add(&format!(
            "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"4\" fill=\"{fill}\" stroke=\"{color}\" stroke-width=\"1.5\"/>"
        ));
    }

    pub(crate) fn bar(&mut self, [x, y]: [f64; 2], [width, height]: [f64; 2], color: &str) {
        self.add(&format!(
            "<rect x=\"{x:.1}\" y=\"{y:.1}\" width=\"{width:.1}\" height=\"{height:.1}\" fill=\"{color}\"/>"
        ));
    }

    /// Ticks of a horizontal scale: a rule from `top` to `bottom` at each, its value below.
    pub(crate) fn columns(&mut self, scale: Scale, top: f64, bottom: f64) {
        for (value, label) in scale.ticks() {
            let x = scale.at(value);
            self.rule(
                [x, top],
                [x, bottom],
                if value == 0.0 { "axis" } else { "rule" },
            );
            self.text([x, bottom + 16.0], Anchor::Middle, "faint", &label);
        }
    }

    /// Ticks of a vertical scale: a rule from `left` to `right` at each, its value to the left.
    pub(crate) fn rows(&mut self, scale: Scale, left: f64, right: f64) {
        for (value, label) in scale.ticks() {
            let y = scale.at(value);
            self.rule([left, y], [right, y], "rule");
            self.text([left - 6.0, y + 4.0], Anchor::End, "faint", &label);
        }
    }
}

impl Scale {
    /// A scale from pixel to pixel that shows all values, with about five ticks; both ends are
    /// ticks.
    pub(crate) fn for_values(values: impl IntoIterator<Item = f64>, pixels: [f64; 2]) -> Self {
        let mut ends = [f64::INFINITY, f64::NEG_INFINITY];
        for value in values.into_iter().filter(|value| value.is_finite()) {
            ends = [ends[0].min(value), ends[1].max(value)];
        }
        if ends[0] > ends[1] {
            ends = [0.0, 1.0];
        }
        let rough = ((ends[1] - ends[0]) / 5.0).max(1e-3);
        let decade = 10f64.powf(rough.log10().floor());
        let step = [1.0, 2.0, 5.0, 10.0]
            .map(|times| times * decade)
            .into_iter()
            .find(|step| *step >= rough * 0.999);
        let step = step.unwrap_or(10.0 * decade);
        let (low, high) = (
            (ends[0] / step).floor() * step,
            (ends[1] / step).ceil() * step,
        );
        Self {
            values: [low, if high > low { high } else { low + step }],
            pixels,
            step,
        }
    }

    /// The value at the first pixel.
    pub(crate) fn low(&self) -> f64 {
        self.values[0]
    }

    /// The value at the last pixel.
    pub(crate) fn high(&self) -> f64 {
        self.values[1]
    }

    /// Decimals of its ticks.
    pub(crate) fn decimals(&self) -> usize {
        (-self.step.log10().floor()).max(0.0) as usize
    }

    /// The pixel of a value.
    pub(crate) fn at(&self, value: f64) -> f64 {
        let ([low, high], [first, last]) = (self.values, self.pixels);
        first + (value - low) / (high - low) * (last - first)
    }

    fn ticks(&self) -> impl Iterator<Item = (f64, String)> {
        let Self {
            values: [low, high],
            step,
            ..
        } = *self;
        let decimals = self.decimals();
        let count = ((high - low) / step).round() as usize;
        (0..=count).map(move |i| {
            // Whole multiples of the step: no tick misses zero by a rounding error.
            let value = ((low / step).round() + i as f64) * step;
            (value, planagent_runs::report::fixed(value, decimals))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scales_cover_their_values_and_end_at_ticks() {
        let scale = Scale::for_values([-3.2, 7.9], [100.0, 200.0]);
        let ticks: Vec<String> = scale.ticks().map(|(_, label)| label).collect();
        assert_eq!(ticks, ["-5", "0", "5", "10"]);
        assert!((scale.at(-5.0) - 100.0).abs() < 1e-9 && (scale.at(10.0) - 200.0).abs() < 1e-9);
        let small: Vec<String> = Scale::for_values([0.1, 0.4], [0.0, 1.0])
            .ticks()
            .map(|(_, label)| label)
            .collect();
        assert_eq!(small, ["0.1", "0.2", "0.3", "0.4"]);
        for values in [vec![], vec![2.0], vec![f64::NAN]] {
            let scale = Scale::for_values(values, [0.0, 10.0]);
            assert!(scale.at(scale.values[1]).is_finite() && scale.ticks().count() >= 2);
        }
    }

    #[test]
    fn text_is_escaped() {
        let mut picture = Picture::new(10.0);
        picture.text([0.0, 0.0], Anchor::Start, "", "a < b & c");
        assert!(picture.finish(10.0, "<t>").contains("a &lt; b &amp; c"));
    }
}
