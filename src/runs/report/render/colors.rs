//! The colors of pictures: those of the page's light theme, read from its style sheet.

use std::sync::LazyLock;

/// Red, green, blue.
pub(super) type Rgb = [u8; 3];

/// The page's colors; the light theme is its first block.
const STYLE: &str = include_str!("../page/assets/theme.css");

/// The colors by their names in the style sheet.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Colors {
    pub(super) paper: Rgb,
    pub(super) panel: Rgb,
    pub(super) ink: Rgb,
    pub(super) ink_soft: Rgb,
    pub(super) line: Rgb,
    pub(super) line_strong: Rgb,
    pub(super) ground: Rgb,
    pub(super) drivable: Rgb,
    pub(super) road: Rgb,
    pub(super) route: Rgb,
    pub(super) centerline: Rgb,
    pub(super) crosswalk: Rgb,
    pub(super) stop: Rgb,
    pub(super) ego: Rgb,
    pub(super) vehicle: Rgb,
    pub(super) bicycle: Rgb,
    pub(super) pedestrian: Rgb,
    pub(super) fixed: Rgb,
    pub(super) tried: Rgb,
    pub(super) red: Rgb,
    pub(super) amber: Rgb,
    pub(super) green: Rgb,
}

impl Colors {
    /// All of them.
    pub(super) fn all(&self) -> [Rgb; 22] {
        // Taken apart by name, so that the compiler asks for each new color here.
        let Self {
            paper,
            panel,
            ink,
            ink_soft,
            line,
            line_strong,
            ground,
            drivable,
            road,
            route,
            centerline,
            ..
        } = *self;
        let Self {
            crosswalk,
            stop,
            ego,
            vehicle,
            bicycle,
            pedestrian,
            fixed,
            tried,
            red,
            amber,
            green,
            ..
        } = *self;
        [
            paper,
            panel,
            ink,
            ink_soft,
            line,
            line_strong,
            ground,
            drivable,
            road,
            route,
            centerline,
            crosswalk,
            stop,
            ego,
            vehicle,
            bicycle,
            pedestrian,
            fixed,
            tried,
            red,
            amber,
            green,
        ]
    }
}

/// The colors of the light theme.
pub(super) static COLORS: LazyLock<Colors> = LazyLock::new(|| {
    let theme = STYLE
        .split('}')
        .next()
        .expect("a split gives one part at least");
    let color = |name: &str| color(theme, name).expect("the style sheet has every color");
    Colors {
        paper: color("paper"),
        panel: color("panel"),
        ink: color("ink"),
        ink_soft: color("ink-soft"),
        line: color("line"),
        line_strong: color("line-strong"),
        ground: color("ground"),
        drivable: color("drivable"),
        road: color("road"),
        route: color("route"),
        centerline: color("centerline"),
        crosswalk: color("crosswalk"),
        stop: color("stop"),
        ego: color("ego"),
        vehicle: color("vehicle"),
        bicycle: color("bicycle"),
        pedestrian: color("pedestrian"),
        fixed: color("static"),
        tried: color("tried"),
        red: color("red"),
        amber: color("amber"),
        green: color("green"),
    }
});

/// The color of a custom property: `--NAME: #rrggbb`.
fn color(theme: &str, name: &str) -> Option<Rgb> {
    let (_, after) = theme.split_once(&format!("--{name}: #"))?;
    let part = |i: usize| u8::from_str_radix(after.get(2 * i..2 * i + 2)?, 16).ok();
    Some([part(0)?, part(1)?, part(2)?])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_color_is_in_the_style_sheet() {
        let Colors {
            paper,
            panel,
            ink,
            ego,
            fixed,
            ground,
            road,
            route,
            ..
        } = &*COLORS;
        assert_eq!((*panel, *paper != [0; 3]), ([255; 3], true));
        // No color of the light theme is black, so a missing one shows.
        let text = format!("{:?}", *COLORS);
        assert!(!text.contains("[0, 0, 0]"), "{text}");
        assert!(ink.iter().sum::<u8>() < 120 && ego != fixed && road != ground && route != road);
    }
}
