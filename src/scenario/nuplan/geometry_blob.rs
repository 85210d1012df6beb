//! Geometries as a `GeoPackage` stores them: a header (`GP`, version, flags, reference system, envelope), then well-known binary.
//!
//! Reading takes both byte orders, all kinds of envelope and three or four dimensions (only x and y are kept), and trusts no count:
//! a damaged blob is an error, never a panic or a huge allocation. Bytes behind the geometry are not looked at. Written are little-endian
//! blobs of two dimensions with an envelope.

use geo::{BoundingRect, Coord, Geometry, LineString, MultiPolygon, Point, Polygon};
use geozero::error::GeozeroError;
use geozero::wkb::process_wkb_geom;
use geozero::{CoordDimensions, GeomProcessor, ToWkb};

/// Bytes of the header before the envelope: magic, version, flags, reference system.
const FIXED_HEADER: usize = 8;
/// First two bytes of every blob.
const MAGIC: &[u8; 2] = b"GP";
/// Flag bit: the header's numbers are little-endian.
const LITTLE_ENDIAN: u8 = 0b0000_0001;
/// Flag bit: the blob is of an extended type.
const EXTENDED: u8 = 0b0010_0000;
/// Bytes of each kind of envelope: none, x y, x y z, x y m, x y z m.
const ENVELOPE_BYTES: [usize; 5] = [0, 32, 48, 48, 64];

/// The kinds of geometry that maps hold, each with its multiple kind.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum GeometryKind {
    /// `POINT`, `MULTIPOINT`.
    Point,
    /// `LINESTRING`, `MULTILINESTRING`.
    Line,
    /// `POLYGON`, `MULTIPOLYGON`.
    Polygon,
}

impl GeometryKind {
    /// Codes of the single and the multiple kind in well-known binary.
    fn codes(self) -> [u32; 2] {
        match self {
            Self::Point => [1, 4],
            Self::Line => [2, 5],
            Self::Polygon => [3, 6],
        }
    }
}

impl std::fmt::Display for GeometryKind {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Point => "point",
            Self::Line => "line",
            Self::Polygon => "polygon",
        })
    }
}

/// What is wrong with a blob.
#[derive(Debug, thiserror::Error)]
pub enum BlobError {
    /// It ends inside the header.
    #[error("the geometry blob ends inside its header: {needed} bytes needed, {got} there")]
    Truncated {
        /// Bytes that the header needs.
        needed: usize,
        /// Bytes of the blob.
        got: usize,
    },
    /// It does not begin with `GP`.
    #[error("no GeoPackage geometry: it begins with {0:?} instead of \"GP\"")]
    Magic([u8; 2]),
    /// Its version is not 0.
    #[error("version {0} of the GeoPackage geometry header is not known")]
    Version(u8),
    /// Its flags name an envelope that does not exist or an extended type.
    #[error("flags {0:#010b} of the GeoPackage geometry header are not known")]
    Flags(u8),
    /// It is in another reference system than its layer should be.
    #[error("the geometry is in reference system {got}, expected {expected}")]
    ReferenceSystem {
        /// What it should be.
        expected: i32,
        /// What it says.
        got: i32,
    },
    /// It is of another kind than its layer should hold.
    #[error("the geometry is of type {got} of well-known binary, expected a {expected}")]
    Kind {
        /// What it should be.
        expected: GeometryKind,
        /// Code of what it is.
        got: u32,
    },
    /// Its well-known binary is damaged.
    #[error("the geometry's well-known binary is damaged: {0}")]
    Damaged(#[source] GeozeroError),
    /// A coordinate is NaN or infinite.
    #[error("coordinate {index} of the geometry is not finite: ({x}, {y})")]
    NotFinite {
        /// Which one, counted over the whole geometry.
        index: usize,
        /// Its x.
        x: f64,
        /// Its y.
        y: f64,
    },
    /// There is nothing in it.
    #[error("the geometry is empty")]
    Empty,
    /// Several parts where one is expected.
    #[error("the geometry has {0} parts, expected one")]
    Parts(usize),
}

/// The points of a blob in reference system `srs_id`, at least one.
///
/// # Errors
/// When the blob is damaged, in another reference system, of another kind, empty or not finite.
pub fn decode_points(blob: &[u8], srs_id: i32) -> Result<Vec<Coord<f64>>, BlobError> {
    some(decode(blob, srs_id, GeometryKind::Point)?.points)
}

/// The lines of a blob in reference system `srs_id`, at least one.
///
/// # Errors
/// As [`decode_points`].
pub fn decode_lines(blob: &[u8], srs_id: i32) -> Result<Vec<LineString<f64>>, BlobError> {
    some(decode(blob, srs_id, GeometryKind::Line)?.lines)
}

/// The one line of a blob in reference system `srs_id`.
///
/// # Errors
/// As [`decode_points`], and when there are several.
pub fn decode_line(blob: &[u8], srs_id: i32) -> Result<LineString<f64>, BlobError> {
    only(decode_lines(blob, srs_id)?)
}

/// The polygons of a blob in reference system `srs_id`, at least one, each with its holes.
///
/// # Errors
/// As [`decode_points`].
pub fn decode_polygons(blob: &[u8], srs_id: i32) -> Result<Vec<Polygon<f64>>, BlobError> {
    some(decode(blob, srs_id, GeometryKind::Polygon)?.polygons)
}

/// The one polygon of a blob in reference system `srs_id`, with its holes.
///
/// # Errors
/// As [`decode_points`], and when there are several.
pub fn decode_polygon(blob: &[u8], srs_id: i32) -> Result<Polygon<f64>, BlobError> {
    only(decode_polygons(blob, srs_id)?)
}

/// The blob of a point in reference system `srs_id`.
///
/// # Errors
/// When it is not finite.
pub fn encode_point(point: Coord<f64>, srs_id: i32) -> Result<Vec<u8>, BlobError> {
    encode(&Geometry::Point(Point(point)), srs_id)
}

/// The blob of a line in reference system `srs_id`.
///
/// # Errors
/// When it is empty or not finite.
pub fn encode_line(line: LineString<f64>, srs_id: i32) -> Result<Vec<u8>, BlobError> {
    encode(&Geometry::LineString(line), srs_id)
}

/// The blob of a polygon with its holes in reference system `srs_id`.
///
/// # Errors
/// When it is empty or not finite.
pub fn encode_polygon(polygon: Polygon<f64>, srs_id: i32) -> Result<Vec<u8>, BlobError> {
    encode(&Geometry::Polygon(polygon), srs_id)
}

/// The blob of several polygons as one `MULTIPOLYGON` in reference system `srs_id`.
///
/// # Errors
/// When there are none or a coordinate is not finite.
pub fn encode_polygons(polygons: Vec<Polygon<f64>>, srs_id: i32) -> Result<Vec<u8>, BlobError> {
    encode(&Geometry::MultiPolygon(MultiPolygon(polygons)), srs_id)
}

fn encode(geometry: &Geometry<f64>, srs_id: i32) -> Result<Vec<u8>, BlobError> {
    use geo::CoordsIter;
    if let Some((index, c)) = geometry.coords_iter().enumerate().find(|(_, c)| !c.x.is_finite() || !c.y.is_finite()) {
        return Err(BlobError::NotFinite { index, x: c.x, y: c.y });
    }
    let around = geometry.bounding_rect().ok_or(BlobError::Empty)?;
    let envelope = match geometry {
        Geometry::Point(_) => Vec::new(),
        _ => vec![around.min().x, around.max().x, around.min().y, around.max().y],
    };
    geometry.to_gpkg_wkb(CoordDimensions::xy(), Some(srs_id), envelope).map_err(BlobError::Damaged)
}

fn decode(blob: &[u8], srs_id: i32, expected: GeometryKind) -> Result<Parts, BlobError> {
    let (got, mut wkb) = header(blob)?;
    if got != srs_id {
        return Err(BlobError::ReferenceSystem { expected: srs_id, got });
    }
    let code = type_code(wkb)?;
    if !expected.codes().contains(&(code % 1000)) {
        return Err(BlobError::Kind { expected, got: code });
    }
    let mut parts = Parts::default();
    let read = process_wkb_geom(&mut wkb, &mut parts);
    match parts.not_finite {
        Some((index, c)) => Err(BlobError::NotFinite { index, x: c.x, y: c.y }),
        None => read.map(|()| parts).map_err(BlobError::Damaged),
    }
}

/// The reference system of a blob, and its well-known binary.
fn header(blob: &[u8]) -> Result<(i32, &[u8]), BlobError> {
    let truncated = |needed: usize| BlobError::Truncated { needed, got: blob.len() };
    let Some((&[m0, m1, version, flags, s0, s1, s2, s3], rest)) = blob.split_first_chunk::<FIXED_HEADER>() else {
        return Err(truncated(FIXED_HEADER));
    };
    if [m0, m1] != *MAGIC {
        return Err(BlobError::Magic([m0, m1]));
    }
    if version != 0 {
        return Err(BlobError::Version(version));
    }
    let kind = usize::from(flags >> 1 & 0b111);
    let envelope = *ENVELOPE_BYTES.get(kind).filter(|_| flags & EXTENDED == 0).ok_or(BlobError::Flags(flags))?;
    let srs = [s0, s1, s2, s3];
    let srs_id = if flags & LITTLE_ENDIAN == 0 { i32::from_be_bytes(srs) } else { i32::from_le_bytes(srs) };
    let wkb = rest.get(envelope..).ok_or_else(|| truncated(FIXED_HEADER + envelope))?;
    Ok((srs_id, wkb))
}

/// Type code of well-known binary, its dimensions in the thousands.
fn type_code(wkb: &[u8]) -> Result<u32, BlobError> {
    match wkb.first_chunk::<5>() {
        Some(&[0, a, b, c, d]) => Ok(u32::from_be_bytes([a, b, c, d])),
        Some(&[_, a, b, c, d]) => Ok(u32::from_le_bytes([a, b, c, d])),
        None => Err(BlobError::Damaged(GeozeroError::GeometryFormat)),
    }
}

fn some<T>(parts: Vec<T>) -> Result<Vec<T>, BlobError> {
    if parts.is_empty() { Err(BlobError::Empty) } else { Ok(parts) }
}

fn only<T>(parts: Vec<T>) -> Result<T, BlobError> {
    let count = parts.len();
    let mut parts = parts.into_iter();
    match (parts.next(), count) {
        (Some(part), 1) => Ok(part),
        _ => Err(BlobError::Parts(count)),
    }
}

/// What a blob is made of, as it is read. Nothing is reserved by the counts of the blob.
#[derive(Debug, Default)]
struct Parts {
    points: Vec<Coord<f64>>,
    lines: Vec<LineString<f64>>,
    polygons: Vec<Polygon<f64>>,
    /// Vertices of the line or ring being read.
    vertices: Option<Vec<Coord<f64>>>,
    /// Rings of the polygon being read.
    rings: Option<Vec<LineString<f64>>>,
    /// Coordinates read so far.
    read: usize,
    not_finite: Option<(usize, Coord<f64>)>,
}

impl GeomProcessor for Parts {
    fn xy(&mut self, x: f64, y: f64, _: usize) -> geozero::error::Result<()> {
        let coord = Coord { x, y };
        if !x.is_finite() || !y.is_finite() {
            self.not_finite = Some((self.read, coord));
            return Err(GeozeroError::Geometry("a coordinate is not finite".to_owned()));
        }
        self.read += 1;
        self.vertices.as_mut().unwrap_or(&mut self.points).push(coord);
        Ok(())
    }

    fn empty_point(&mut self, _: usize) -> geozero::error::Result<()> {
        Ok(())
    }

    fn linestring_begin(&mut self, _: bool, _: usize, _: usize) -> geozero::error::Result<()> {
        self.vertices = Some(Vec::new());
        Ok(())
    }

    fn linestring_end(&mut self, _: bool, _: usize) -> geozero::error::Result<()> {
        let vertices = self.vertices.take().unwrap_or_default();
        if !vertices.is_empty() {
            self.rings.as_mut().unwrap_or(&mut self.lines).push(LineString(vertices));
        }
        Ok(())
    }

    fn polygon_begin(&mut self, _: bool, _: usize, _: usize) -> geozero::error::Result<()> {
        self.rings = Some(Vec::new());
        Ok(())
    }

    fn polygon_end(&mut self, _: bool, _: usize) -> geozero::error::Result<()> {
        let mut rings = self.rings.take().unwrap_or_default().into_iter();
        if let Some(outer) = rings.next() {
            self.polygons.push(Polygon::new(outer, rings.collect()));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenario::nuplan::projection::WGS84;
    use proptest::prelude::*;

    fn square(side: f64) -> LineString<f64> {
        LineString::from(vec![(0.0, 0.0), (side, 0.0), (side, side), (0.0, side), (0.0, 0.0)])
    }

    /// A blob with the numbers of its header and its well-known binary in one byte order.
    fn blob(little: bool, envelope: u8, wkb: impl Fn(&mut dyn FnMut(Number))) -> Vec<u8> {
        let mut bytes = vec![b'G', b'P', 0, envelope << 1 | u8::from(little)];
        let mut put = |number: Number| match number {
            Number::Byte(b) => bytes.push(b),
            Number::Int(i) => bytes.extend(if little { i.to_le_bytes() } else { i.to_be_bytes() }),
            Number::Float(f) => bytes.extend(if little { f.to_le_bytes() } else { f.to_be_bytes() }),
        };
        put(Number::Int(4326));
        (0..ENVELOPE_BYTES[usize::from(envelope)] / 8).for_each(|i| put(Number::Float(i as f64)));
        put(Number::Byte(u8::from(little)));
        wkb(&mut put);
        bytes
    }

    enum Number {
        Byte(u8),
        Int(u32),
        Float(f64),
    }

    /// A line of two vertices with `extra` further dimensions.
    fn line(code: u32, extra: usize) -> impl Fn(&mut dyn FnMut(Number)) {
        move |put| {
            put(Number::Int(code));
            put(Number::Int(2));
            for x in [1.5, 2.5] {
                put(Number::Float(x));
                put(Number::Float(-x));
                (0..extra).for_each(|_| put(Number::Float(9.0)));
            }
        }
    }

    #[test]
    fn both_byte_orders_every_envelope_and_dimension_read_alike() {
        let expected = LineString::from(vec![(1.5, -1.5), (2.5, -2.5)]);
        for little in [false, true] {
            for envelope in 0..5 {
                for (code, extra) in [(2, 0), (1002, 1), (2002, 1), (3002, 2)] {
                    let blob = blob(little, envelope, line(code, extra));
                    assert_eq!(decode_line(&blob, WGS84).unwrap(), expected, "{little} {envelope} {code}");
                }
            }
        }
    }

    #[test]
    fn what_is_written_reads_back() {
        let point = Coord { x: -115.17, y: 36.11 };
        assert_eq!(decode_points(&encode_point(point, WGS84).unwrap(), WGS84).unwrap(), [point]);
        assert_eq!(decode_line(&encode_line(square(2.0), WGS84).unwrap(), WGS84).unwrap(), square(2.0));
        let holed = Polygon::new(square(4.0), vec![square(1.0)]);
        let blob = encode_polygon(holed.clone(), WGS84).unwrap();
        assert_eq!(blob[..4], [b'G', b'P', 0, 0b11]);
        assert_eq!(decode_polygon(&blob, WGS84).unwrap(), holed);
        let several = vec![holed, Polygon::new(square(9.0), vec![])];
        let blob = encode_polygons(several.clone(), WGS84).unwrap();
        assert_eq!(decode_polygons(&blob, WGS84).unwrap(), several);
        assert!(matches!(decode_polygon(&blob, WGS84), Err(BlobError::Parts(2))));
    }

    #[test]
    fn every_fault_has_its_name() {
        let good = encode_line(square(2.0), WGS84).unwrap();
        let with = |place: usize, byte: u8| {
            let mut blob = good.clone();
            blob[place] = byte;
            decode_line(&blob, WGS84).unwrap_err()
        };
        assert!(matches!(with(0, b'X'), BlobError::Magic([b'X', b'P'])));
        assert!(matches!(with(2, 7), BlobError::Version(7)));
        assert!(matches!(with(3, 0b1011), BlobError::Flags(0b1011)));
        assert!(matches!(with(3, 0b10_0011), BlobError::Flags(0b10_0011)));
        assert!(matches!(decode_line(&good, 3857), Err(BlobError::ReferenceSystem { expected: 3857, got: 4326 })));
        assert!(matches!(
            decode_polygon(&good, WGS84),
            Err(BlobError::Kind { expected: GeometryKind::Polygon, got: 2 })
        ));
        assert!(matches!(decode_line(&good[..20], WGS84), Err(BlobError::Truncated { needed: 40, got: 20 })));
        assert!(matches!(decode_line(&[], WGS84), Err(BlobError::Truncated { needed: 8, got: 0 })));
        assert!(matches!(decode_line(&good[..good.len() - 1], WGS84), Err(BlobError::Damaged(_))));
        assert!(matches!(encode_polygons(vec![], WGS84), Err(BlobError::Empty)));
        let nan = LineString::from(vec![(0.0, 0.0), (f64::NAN, 1.0)]);
        assert!(matches!(encode_line(nan, WGS84), Err(BlobError::NotFinite { index: 1, .. })));
        let mut blob = good.clone();
        let second = FIXED_HEADER + 32 + 9 + 16;
        blob[second..second + 8].copy_from_slice(&f64::NAN.to_le_bytes());
        assert!(matches!(decode_line(&blob, WGS84), Err(BlobError::NotFinite { index: 1, .. })));
    }

    #[test]
    fn counts_are_not_believed_and_nothing_nests() {
        let endless = |code: u32| {
            blob(true, 0, move |put| {
                put(Number::Int(code));
                put(Number::Int(u32::MAX));
            })
        };
        for code in [2, 5] {
            assert!(matches!(decode_lines(&endless(code), WGS84), Err(BlobError::Damaged(_))));
        }
        for code in [3, 6] {
            assert!(matches!(decode_polygons(&endless(code), WGS84), Err(BlobError::Damaged(_))));
        }
        assert!(matches!(decode_points(&endless(4), WGS84), Err(BlobError::Damaged(_))));
        let mut deep = endless(7);
        (0..100_000).for_each(|_| deep.extend([1, 7, 0, 0, 0, 1, 0, 0, 0]));
        assert!(matches!(decode_points(&deep, WGS84), Err(BlobError::Kind { got: 7, .. })));
        let empty = blob(true, 0, |put| {
            put(Number::Int(3));
            put(Number::Int(0));
        });
        assert!(matches!(decode_polygons(&empty, WGS84), Err(BlobError::Empty)));
    }

    proptest! {
        #[test]
        fn reading_never_panics(bytes in prop::collection::vec(any::<u8>(), 0..200), place in 0usize..200, header: bool) {
            let mut blob = bytes.clone();
            if header {
                blob = encode_polygon(Polygon::new(square(4.0), vec![square(1.0)]), WGS84).unwrap();
                let at = place % blob.len();
                blob.splice(at..at, bytes.iter().copied().take(3));
                blob.truncate(200 + place);
            }
            let _ = decode_points(&blob, WGS84).is_ok();
            let _ = decode_lines(&blob, WGS84).is_ok();
            let _ = decode_polygons(&blob, WGS84).is_ok();
        }

        #[test]
        fn any_polygon_comes_back(ring in prop::collection::vec((-180.0..180.0f64, -90.0..90.0f64), 3..40)) {
            let polygon = Polygon::new(LineString::from(ring), vec![]);
            prop_assert_eq!(decode_polygon(&encode_polygon(polygon.clone(), WGS84).unwrap(), WGS84).unwrap(), polygon);
        }
    }
}
