//! The legend below a picture: what its scene shows, as in the page's legend.

use super::canvas::{Canvas, Pen};
use super::colors::{COLORS, Rgb};
use super::lettering::Lettering;
use super::scene::DrawnScene;
use planagent_world::{ObjectKind, SignalStatus};

/// Size of a swatch and the gap after it, and after an entry, in ems.
const SWATCH_EM: (f32, f32) = (2.0, 0.9);
const GAP_EM: f32 = 0.45;
const ENTRY_GAP_EM: f32 = 1.3;

/// An entry of the legend.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Entry {
    Ego,
    Plan,
    Refused,
    Trail,
    Vehicle,
    Bicycle,
    Pedestrian,
    Fixed,
    Arrow,
    Route,
    Lane,
    Drivable,
    Crosswalk,
    StopLine,
    Red,
    Yellow,
    Green,
}

impl Entry {
    /// What a scene shows.
    pub(super) fn all_in(scene: &DrawnScene<'_>) -> Vec<Self> {
        let kind = |kinds: &[ObjectKind]| {
            scene
                .objects
                .iter()
                .any(|object| kinds.contains(&object.kind))
        };
        let light = |status| scene.lights.iter().any(|(_, shown)| *shown == status);
        let fixed = [
            ObjectKind::TrafficCone,
            ObjectKind::Barrier,
            ObjectKind::CzoneSign,
            ObjectKind::GenericObject,
        ];
        let map = scene.map;
        // In the order of the page's legend.
        let shown = [
            (Self::Ego, true),
            (Self::Plan, !scene.plan.is_empty()),
            (Self::Refused, !scene.refused.is_empty()),
            (Self::Trail, scene.trail.len() > 1),
            (Self::Vehicle, kind(&[ObjectKind::Vehicle])),
            (Self::Bicycle, kind(&[ObjectKind::Bicycle])),
            (Self::Pedestrian, kind(&[ObjectKind::Pedestrian])),
            (Self::Fixed, kind(&fixed)),
            (Self::Arrow, true),
            (Self::Route, !map.route.is_empty()),
            (Self::Lane, !map.lanes.is_empty()),
            (Self::Drivable, !map.drivable.is_empty()),
            (Self::Crosswalk, !map.crosswalks.is_empty()),
            (Self::StopLine, !map.stop_lines.is_empty()),
            (Self::Red, light(SignalStatus::Red)),
            (Self::Yellow, light(SignalStatus::Yellow)),
            (Self::Green, light(SignalStatus::Green)),
        ];
        shown
            .into_iter()
            .filter(|(_, shown)| *shown)
            .map(|(entry, _)| entry)
            .collect()
    }

    /// The words of the page's legend.
    fn words(self) -> &'static str {
        match self {
            Self::Ego => "ego",
            Self::Plan => "active plan, a dot each second",
            Self::Refused => "refused plan with its score",
            Self::Trail => "trail of the ego",
            Self::Vehicle => "vehicle",
            Self::Bicycle => "bicycle",
            Self::Pedestrian => "pedestrian",
            Self::Fixed => "static object",
            Self::Arrow => "path in 0.8 s at this speed",
            Self::Route => "route",
            Self::Lane => "lane",
            Self::Drivable => "other drivable area",
            Self::Crosswalk => "crosswalk",
            Self::StopLine => "stop line",
            Self::Red => "red light",
            Self::Yellow => "yellow light",
            Self::Green => "green light",
        }
    }

    /// Draws the swatch: its left end and middle height in pixels, its size.
    fn swatch(self, canvas: &mut Canvas, (x, y): (f32, f32), (width, height): (f32, f32)) {
        let colors = &*COLORS;
        let center = (x + width / 2.0, y);
        let mut line = |pen: Pen| canvas.line(&[(x, y), (x + width, y)], pen);
        // One match: an arm draws what `scene.rs` draws, in small.
        match self {
            Self::Ego => vehicle(canvas, center, (width, height), colors.ego),
            Self::Vehicle => vehicle(canvas, center, (width, height), colors.vehicle),
            Self::Bicycle => vehicle(canvas, center, (width, height), colors.bicycle),
            Self::Pedestrian => canvas.disc(center, height / 2.0, colors.pedestrian),
            Self::Fixed => canvas.rectangle(center, (height, height), 0.0, colors.fixed, 1.0),
            Self::Trail => line(Pen::solid(colors.ego, height / 6.0)),
            Self::Refused => line(Pen::dashed(
                colors.tried,
                height / 2.4,
                [height / 2.0, height / 3.5],
            )),
            Self::Plan => {
                line(Pen::solid(colors.ego, height / 3.5));
                canvas.disc((x + 0.7 * width, y), height / 3.2, colors.ego);
            }
            Self::Arrow => {
                let (tip, head) = (x + width, height / 2.6);
                line(Pen::solid(colors.ink, height / 8.0));
                canvas.line(
                    &[(tip - head, y - head), (tip, y), (tip - head, y + head)],
                    Pen::solid(colors.ink, height / 8.0),
                );
            }
            Self::Route => area(canvas, center, (width, height), colors.route),
            Self::Lane => area(canvas, center, (width, height), colors.road),
            Self::Drivable => area(canvas, center, (width, height), colors.drivable),
            Self::Crosswalk => {
                area(canvas, center, (width, height), colors.road);
                for share in [0.2, 0.5, 0.8] {
                    canvas.rectangle(
                        (x + share * width, y),
                        (0.16 * width, height),
                        0.0,
                        colors.crosswalk,
                        1.0,
                    );
                }
            }
            Self::StopLine => area(canvas, center, (width, height / 3.0), colors.stop),
            Self::Red => canvas.rectangle(center, (width, 0.6 * height), 0.0, colors.red, 1.0),
            Self::Yellow => {
                canvas.rectangle(center, (width, 0.35 * height), 0.0, colors.amber, 1.0);
            }
            Self::Green => canvas.rectangle(center, (width, 0.35 * height), 0.0, colors.green, 1.0),
        }
    }
}

fn vehicle(canvas: &mut Canvas, center: (f32, f32), (width, height): (f32, f32), color: Rgb) {
    canvas.rectangle(center, (width, height), 0.0, color, 1.0);
    let mark = (center.0 + 0.26 * width, center.1);
    canvas.rectangle(mark, (0.12 * width, 0.72 * height), 0.0, COLORS.panel, 0.75);
}

fn area(canvas: &mut Canvas, center: (f32, f32), (width, height): (f32, f32), color: Rgb) {
    canvas.rectangle(center, (width, height), 0.0, COLORS.line_strong, 1.0);
    canvas.rectangle(center, (width - 1.5, height - 1.5), 0.0, color, 1.0);
}

/// A legend in rows.
#[derive(Debug, Clone)]
pub(super) struct Legend {
    rows: Vec<Vec<(Entry, f32)>>,
    letters: Lettering,
}

impl Legend {
    /// The entries in rows of at most `width` pixels.
    pub(super) fn new(entries: &[Entry], letters: Lettering, width: f32) -> Self {
        let em = letters.size;
        let mut rows: Vec<Vec<(Entry, f32)>> = Vec::new();
        let mut x = f32::INFINITY;
        for &entry in entries {
            let own = (SWATCH_EM.0 + GAP_EM) * em + letters.width(entry.words());
            if x + own > width {
                rows.push(Vec::new());
                x = 0.0;
            }
            if let Some(row) = rows.last_mut() {
                row.push((entry, x));
            }
            x += own + ENTRY_GAP_EM * em;
        }
        Self { rows, letters }
    }

    /// Its entries, in order.
    pub(super) fn entries(&self) -> Vec<Entry> {
        self.rows
            .iter()
            .flatten()
            .map(|(entry, _)| *entry)
            .collect()
    }

    /// Its height, pixels.
    pub(super) fn height(&self) -> f32 {
        self.rows.len() as f32 * self.letters.line()
    }

    /// Draws it with its upper left corner at a pixel.
    pub(super) fn draw(&self, canvas: &mut Canvas, (left, top): (f32, f32)) {
        let em = self.letters.size;
        for (i, row) in self.rows.iter().enumerate() {
            let baseline = top + i as f32 * self.letters.line() + em;
            for (entry, x) in row {
                entry.swatch(
                    canvas,
                    (left + x, baseline - 0.36 * em),
                    (SWATCH_EM.0 * em, SWATCH_EM.1 * em),
                );
                let words = (left + x + (SWATCH_EM.0 + GAP_EM) * em, baseline);
                canvas.text(entry.words(), words, self.letters, COLORS.ink_soft);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_legend_has_all_entries_in_rows_that_fit() {
        let entries = [
            Entry::Ego,
            Entry::Plan,
            Entry::Refused,
            Entry::Route,
            Entry::Red,
            Entry::Green,
        ];
        let letters = Lettering::regular(12.0);
        let wide = Legend::new(&entries, letters, 2000.0);
        let narrow = Legend::new(&entries, letters, 240.0);
        assert_eq!(
            (wide.rows.len(), narrow.rows.concat().len()),
            (1, entries.len())
        );
        assert!(narrow.rows.len() > 2 && narrow.height() > wide.height());
        assert!(
            narrow
                .rows
                .iter()
                .all(|row| row.first().is_some_and(|(_, x)| *x == 0.0))
        );
    }
}
