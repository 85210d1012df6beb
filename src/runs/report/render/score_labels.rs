//! The scores of the refused plans: labels at the ends of the plans, where they cover least.

use super::canvas::{Canvas, Pen, Pixel};
use super::colors::COLORS;
use super::lettering::Lettering;
use super::scene::{DrawnScene, View};
use crate::report::number::fixed;
use planagent_world::geometry::OrientedBox;

/// Height of the letters and space around them, pixels of the page.
const LETTERS: f32 = 12.0;
const PADDING: f32 = 3.0;
/// Minimum height of the letters, pixels.
const MIN_LETTERS: f32 = 8.0;
/// Distance of a label from the end of its plan, pixels of the page.
const AWAY: f32 = 8.0;
/// Plans that end within this distance of each other with the same score share a label, pixels of
/// the page.
const SAME_END: f32 = 6.0;
/// Directions in which a label may lie from the end of its plan; the first is preferred.
const DIRECTIONS: [Pixel; 8] = [
    (1.0, 0.0),
    (-1.0, 0.0),
    (1.0, -1.0),
    (-1.0, -1.0),
    (1.0, 1.0),
    (-1.0, 1.0),
    (0.0, -1.0),
    (0.0, 1.0),
];
/// Distances to which a label moves away when nearer places are taken.
const STEPS: [f32; 3] = [1.0, 2.4, 4.0];

/// A rectangle along the sides of the picture: left, top, right, bottom; pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Area {
    left: f32,
    top: f32,
    right: f32,
    bottom: f32,
}

/// Draws the labels over all else.
pub(super) fn draw(canvas: &mut Canvas, scene: &DrawnScene<'_>, view: &View) {
    let (colors, zoom) = (&*COLORS, view.zoom());
    let letters = Lettering::bold((LETTERS * zoom).max(MIN_LETTERS));
    let objects = scene
        .objects
        .iter()
        .map(|object| Area::around(&object.shape, view));
    let mut taken: Vec<Area> = objects
        .chain([Area::around(&scene.ego.footprint(), view)])
        .collect();
    for (end, words) in labels(scene, view) {
        let size = (
            letters.width(&words) + 2.0 * PADDING * zoom,
            letters.size + 2.0 * PADDING * zoom,
        );
        let area = place(end, size, AWAY * zoom, &taken, view.side());
        let center = (
            f32::midpoint(area.left, area.right),
            f32::midpoint(area.top, area.bottom),
        );
        canvas.rectangle(center, size, 0.0, colors.panel, 0.92);
        let [left, top, right, bottom] = [area.left, area.top, area.right, area.bottom];
        let border = [
            (left, top),
            (right, top),
            (right, bottom),
            (left, bottom),
            (left, top),
        ];
        canvas.line(&border, Pen::solid(colors.tried, zoom));
        let baseline = bottom - PADDING * zoom - 0.14 * letters.size;
        canvas.text(
            &words,
            (left + PADDING * zoom, baseline),
            letters,
            colors.tried,
        );
        // Later labels avoid this one too, so the order of the plans decides who moves.
        taken.push(area);
    }
}

/// The ends of the plans with the words of their labels. Equal plans share a label, which says how
/// many they are.
fn labels(scene: &DrawnScene<'_>, view: &View) -> Vec<(Pixel, String)> {
    let mut labels: Vec<(Pixel, String, usize)> = Vec::new();
    for (path, score) in &scene.refused {
        let (Some(&end), Some(score)) = (path.last(), score) else {
            continue;
        };
        let (end, words) = (view.pixel(end), fixed(*score, 2));
        let is_same = |(other, said, _): &&mut (Pixel, String, usize)| {
            (other.0 - end.0).hypot(other.1 - end.1) < SAME_END * view.zoom() && *said == words
        };
        match labels.iter_mut().find(is_same) {
            Some((_, _, count)) => *count += 1,
            None => labels.push((end, words, 1)),
        }
    }
    let said = |words: String, count: usize| {
        if count > 1 {
            format!("{words} ({count} times)")
        } else {
            words
        }
    };
    labels
        .into_iter()
        .map(|(end, words, count)| (end, said(words, count)))
        .collect()
}

/// The place of a label: inside the picture, where it covers least of what is taken.
fn place(end: Pixel, size: Pixel, away: f32, taken: &[Area], side: f32) -> Area {
    let margin = away / 2.0;
    let anchor = (
        end.0.clamp(margin, side - margin),
        end.1.clamp(margin, side - margin),
    );
    let candidates = STEPS
        .into_iter()
        .flat_map(|step| DIRECTIONS.map(|direction| (step, direction)));
    let areas = candidates.map(|(step, (right, down))| {
        let center = (
            anchor.0 + right * (step * away + size.0 / 2.0),
            anchor.1 + down * (step * away + size.1 / 2.0),
        );
        Area::centered(center, size).inside(side, margin)
    });
    let covered = |area: &Area| taken.iter().map(|other| area.overlap(other)).sum::<f32>();
    let mut best: Option<(f32, Area)> = None;
    for area in areas {
        let covers = covered(&area);
        if best.is_none_or(|(least, _)| covers < least) {
            best = Some((covers, area));
        }
    }
    best.map_or_else(|| Area::centered(anchor, size), |(_, area)| area)
}

impl Area {
    fn centered((x, y): Pixel, (width, height): Pixel) -> Self {
        Self {
            left: x - width / 2.0,
            top: y - height / 2.0,
            right: x + width / 2.0,
            bottom: y + height / 2.0,
        }
    }

    /// The bounds of a box on the map.
    fn around(shape: &OrientedBox, view: &View) -> Self {
        let (ahead, aside) = (shape.length / 2.0, shape.width / 2.0);
        let corners = [
            (ahead, aside),
            (ahead, -aside),
            (-ahead, aside),
            (-ahead, -aside),
        ]
        .map(|(x, y)| view.pixel(shape.center.translated(x, y).position()));
        let of = |axis: fn(Pixel) -> f32, pick: fn(f32, f32) -> f32| {
            corners.into_iter().map(axis).reduce(pick)
        };
        let bound = |axis, pick| of(axis, pick).expect("a box has four corners");
        Self {
            left: bound(|p| p.0, f32::min),
            top: bound(|p| p.1, f32::min),
            right: bound(|p| p.0, f32::max),
            bottom: bound(|p| p.1, f32::max),
        }
    }

    /// Moved into the picture.
    fn inside(self, side: f32, margin: f32) -> Self {
        let shift =
            |low: f32, high: f32| (margin - low).max(0.0) - (high - (side - margin)).max(0.0);
        let (right, down) = (shift(self.left, self.right), shift(self.top, self.bottom));
        Self {
            left: self.left + right,
            top: self.top + down,
            right: self.right + right,
            bottom: self.bottom + down,
        }
    }

    /// The common area of two rectangles.
    fn overlap(&self, other: &Self) -> f32 {
        let width = self.right.min(other.right) - self.left.max(other.left);
        let height = self.bottom.min(other.bottom) - self.top.max(other.top);
        width.max(0.0) * height.max(0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: Pixel = (40.0, 18.0);

    #[test]
    fn a_label_avoids_boxes_and_stays_in_the_picture() {
        let free = place((100.0, 100.0), SIZE, 8.0, &[], 400.0);
        assert!(
            free.left > 100.0 && free.top < 100.0 && free.bottom > 100.0,
            "{free:?}"
        );
        let vehicle = Area::centered((130.0, 100.0), (50.0, 25.0));
        let aside = place((100.0, 100.0), SIZE, 8.0, &[vehicle], 400.0);
        assert!(
            aside.overlap(&vehicle) < 1e-3 && free.overlap(&vehicle) > 100.0,
            "{aside:?}"
        );
        // A second label avoids the first.
        let second = place((100.0, 100.0), SIZE, 8.0, &[vehicle, aside], 400.0);
        assert!(
            second.overlap(&aside) < 1e-3 && second.overlap(&vehicle) < 1e-3,
            "{second:?}"
        );
        for end in [
            (-500.0, 50.0),
            (399.0, 399.0),
            (200.0, -9.0),
            (900.0, 900.0),
        ] {
            let Area {
                left,
                top,
                right,
                bottom,
            } = place(end, SIZE, 8.0, &[], 400.0);
            assert!(
                left >= 0.0 && top >= 0.0 && right <= 400.0 && bottom <= 400.0,
                "{end:?}: {left} {top} {right} {bottom}"
            );
        }
    }
}
