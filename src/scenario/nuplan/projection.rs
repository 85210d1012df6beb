//! The universal transverse Mercator projection: between longitude and latitude and the meters of a
//! map.
//!
//! nuPlan's maps store shapes in WGS 84 degrees (EPSG:4326) and name the projection to meters in
//! layer `meta`, key `projectedCoordSystem`, for example `epsg:32619`. Ego poses and boxes of the
//! logs are in these meters.

use proj4rs::Proj;
use proj4rs::transform::transform;
use std::fmt;

/// EPSG code of WGS 84 longitude and latitude, in which maps are stored.
pub const WGS84: i32 = 4326;
/// EPSG code of UTM zone z north, less z.
const NORTH: u32 = 32_600;
/// EPSG code of UTM zone z south, less z.
const SOUTH: u32 = 32_700;
/// Number of zones, 6° wide each.
const ZONES: u32 = 60;

/// Why coordinates cannot be projected.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[allow(missing_docs, reason = "the message of a variant says what it is")]
pub enum ProjectionError {
    #[error("'{0}' does not name a coordinate system: expected for example `epsg:32611`")]
    Name(String),
    #[error(
        "EPSG:{0} is not a UTM zone on WGS 84: expected 32601 to 32660 (north) or 32701 to 32760 (south)"
    )]
    NotUtm(u32),
    /// The coordinates are degrees or meters, as given.
    #[error("EPSG:{epsg} cannot project ({x}, {y}): {reason}")]
    Failed {
        epsg: u32,
        x: f64,
        y: f64,
        reason: String,
    },
}

/// A zone of the projection on WGS 84.
#[derive(Debug, Clone)]
pub struct Utm {
    epsg: u32,
    meters: Proj,
    degrees: Proj,
}

impl Utm {
    /// The zone of an EPSG code.
    pub fn from_epsg(epsg: u32) -> Result<Self, ProjectionError> {
        let (zone, south) = match epsg {
            _ if (NORTH + 1..=NORTH + ZONES).contains(&epsg) => (epsg - NORTH, ""),
            _ if (SOUTH + 1..=SOUTH + ZONES).contains(&epsg) => (epsg - SOUTH, " +south"),
            _ => return Err(ProjectionError::NotUtm(epsg)),
        };
        let proj =
            |text: &str| Proj::from_proj_string(text).map_err(|_| ProjectionError::NotUtm(epsg));
        Ok(Self {
            epsg,
            meters: proj(&format!(
                "+proj=utm +zone={zone}{south} +datum=WGS84 +units=m +no_defs +type=crs"
            ))?,
            degrees: proj("+proj=longlat +datum=WGS84 +no_defs +type=crs")?,
        })
    }

    /// The zone that the layer `meta` of a map names: `epsg:32611`, in upper or lower case.
    pub(crate) fn from_name(name: &str) -> Result<Self, ProjectionError> {
        let unknown = || ProjectionError::Name(name.to_owned());
        let (authority, code) = name.trim().split_once(':').ok_or_else(unknown)?;
        if !authority.eq_ignore_ascii_case("epsg") {
            return Err(unknown());
        }
        Self::from_epsg(code.parse().map_err(|_| unknown())?)
    }

    /// EPSG code.
    pub fn epsg(&self) -> u32 {
        self.epsg
    }

    /// Easting and northing, m, of a longitude and latitude, degrees.
    pub(crate) fn to_utm(&self, lon_deg: f64, lat_deg: f64) -> Result<(f64, f64), ProjectionError> {
        let start = (lon_deg.to_radians(), lat_deg.to_radians());
        project(&self.degrees, &self.meters, start)
            .map_err(|reason| self.failed(lon_deg, lat_deg, reason))
    }

    /// Longitude and latitude, degrees, of an easting and northing, m.
    pub fn to_geographic(&self, x: f64, y: f64) -> Result<(f64, f64), ProjectionError> {
        let (lon, lat) = project(&self.meters, &self.degrees, (x, y))
            .map_err(|reason| self.failed(x, y, reason))?;
        Ok((lon.to_degrees(), lat.to_degrees()))
    }

    fn failed(&self, x: f64, y: f64, reason: String) -> ProjectionError {
        ProjectionError::Failed {
            epsg: self.epsg,
            x,
            y,
            reason,
        }
    }
}

fn project(from: &Proj, to: &Proj, point: (f64, f64)) -> Result<(f64, f64), String> {
    let mut point = (point.0, point.1, 0.0);
    transform(from, to, &mut point).map_err(|error| error.to_string())?;
    if point.0.is_finite() && point.1.is_finite() {
        Ok((point.0, point.1))
    } else {
        Err("the result is not finite".to_owned())
    }
}

impl fmt::Display for Utm {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "epsg:{}", self.epsg)
    }
}

impl PartialEq for Utm {
    fn eq(&self, other: &Self) -> bool {
        self.epsg == other.epsg
    }
}

impl Eq for Utm {}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[derive(serde::Deserialize)]
    struct Sample {
        epsg: u32,
        lon: f64,
        lat: f64,
        x: f64,
        y: f64,
    }

    #[test]
    fn las_vegas_lies_where_its_ego_poses_do() {
        let (x, y) = Utm::from_epsg(32_611)
            .unwrap()
            .to_utm(-115.17, 36.11)
            .unwrap();
        assert!(
            (x - 664_713.0).abs() < 0.5 && (y - 3_997_700.0).abs() < 0.5,
            "{x} {y}"
        );
    }

    #[test]
    fn agrees_with_pyproj_to_a_micrometer() {
        let text = include_str!("../../../tests/fixtures/projection/utm_grid.json");
        let samples: Vec<Sample> = serde_json::from_str(text).unwrap();
        assert!(samples.len() > 500, "only {} samples", samples.len());
        for sample in samples {
            let utm = Utm::from_epsg(sample.epsg).unwrap();
            let (x, y) = utm.to_utm(sample.lon, sample.lat).unwrap();
            let off = (x - sample.x).hypot(y - sample.y);
            assert!(
                off < 1e-6,
                "EPSG:{} ({}, {}): {off} m",
                sample.epsg,
                sample.lon,
                sample.lat
            );
        }
    }

    #[test]
    fn only_utm_on_wgs84_is_known() {
        for epsg in [4326, 32_600, 32_661, 32_700, 32_761, 26_911, 3857] {
            assert_eq!(Utm::from_epsg(epsg), Err(ProjectionError::NotUtm(epsg)));
        }
        assert_eq!(Utm::from_name("EPSG:32619").unwrap().epsg(), 32_619);
        assert_eq!(
            Utm::from_name("epsg:32733").unwrap().to_string(),
            "epsg:32733"
        );
        for name in [
            "",
            "32619",
            "epsg:",
            "epsg:32619.0",
            "esri:32619",
            "epsg:-1",
        ] {
            assert_eq!(
                Utm::from_name(name),
                Err(ProjectionError::Name(name.to_owned())),
                "{name}"
            );
        }
    }

    #[test]
    fn what_is_not_finite_fails() {
        let utm = Utm::from_epsg(32_611).unwrap();
        for (x, y) in [
            (f64::NAN, 0.0),
            (0.0, f64::NAN),
            (f64::INFINITY, 0.0),
            (0.0, f64::NEG_INFINITY),
            (1e300, 1e300),
        ] {
            assert!(utm.to_utm(x, y).is_err(), "({x}, {y})");
            assert!(utm.to_geographic(x, y).is_err(), "({x}, {y})");
        }
    }

    proptest! {
        #[test]
        fn there_and_back_within_the_zone(zone in 1u32..=60, south: bool, east in -3.0..3.0f64, lat in 0.0..84.0f64) {
            let utm = Utm::from_epsg(if south { SOUTH } else { NORTH } + zone).unwrap();
            let lon = f64::from(zone) * 6.0 - 183.0 + east;
            let (x, y) = utm.to_utm(lon, if south { -lat * 80.0 / 84.0 } else { lat }).unwrap();
            let (lon, lat) = utm.to_geographic(x, y).unwrap();
            let (again_x, again_y) = utm.to_utm(lon, lat).unwrap();
            prop_assert!((again_x - x).hypot(again_y - y) < 1e-7, "{x} {y}: {again_x} {again_y}");
        }
    }
}
