//! Geometries as a `GeoPackage` stores them: a header (`GP`, version, flags, reference system,
//! envelope), then well-known binary.
//!
//! Both byte orders, all kinds of envelope and three or four dimensions can be read; only x and y
//! are kept. A damaged blob is an error: no count in it is trusted. Bytes behind the geometry are
//! ignored. Written blobs are little-endian, of two dimensions, with an envelope.

use geo::{BoundingRect, Coord, CoordsIter, Geometry, LineString, Polygon};
use geozero::error::GeozeroError;
use geozero::wkb::process_wkb_geom;
use geozero::{CoordDimensions, GeomProcessor, ToWkb};
use std::fmt;

/// Flag bit: the numbers of the header are little-endian.
const LITTLE_ENDIAN: u8 = 0b0000_0001;
/// Flag bit: the blob is of an extended type.
const EXTENDED: u8 = 0b0010_0000;
/// Bytes of each kind of envelope: none, x y, x y z, x y m, x y z m.
const ENVELOPE_BYTES: [usize; 5] = [0, 32, 48, 48, 64];

/// The kinds of geometry that a map holds, each with its multiple kind.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum GeometryKind {
    /// `LINESTRING`, `MULTILINESTRING`.
    Line,
    /// `POLYGON`, `MULTIPOLYGON`.
    Polygon,
}

impl fmt::Display for GeometryKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Line => "line",
            Self::Polygon => "polygon",
        })
    }
}

/// What is wrong with a blob.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the message of a variant says what it is")]
pub enum BlobError {
    #[error(
        "no GeoPackage geometry of version 0, or its header is damaged: it begins with {0:02x?}"
    )]
    Header(Vec<u8>),
    #[error("the geometry is in reference system {got}, expected {expected}")]
    ReferenceSystem { expected: i32, got: i32 },
    #[error("the geometry is of type {got} of well-known binary, expected a {expected}")]
    Kind { expected: GeometryKind, got: u32 },
    #[error("the well-known binary of the geometry is damaged: {0}")]
    Damaged(#[source] GeozeroError),
    #[error("coordinate {index} of the geometry is not finite: ({x}, {y})")]
    NotFinite { index: usize, x: f64, y: f64 },
    #[error("the geometry is empty")]
    Empty,
    #[error("the geometry has {0} parts, expected one")]
    Parts(usize),
}

/// The one line of a blob in reference system `srs_id`.
pub(crate) fn decode_line(blob: &[u8], srs_id: i32) -> Result<LineString<f64>, BlobError> {
    let mut lines = decode(blob, srs_id, GeometryKind::Line)?.lines;
    match (lines.pop(), lines.len()) {
        (Some(line), 0) => Ok(line),
        (None, _) => Err(BlobError::Empty),
        (_, more) => Err(BlobError::Parts(more + 1)),
    }
}

/// The polygons of a blob in reference system `srs_id`, at least one, each with its holes.
pub(crate) fn decode_polygons(blob: &[u8], srs_id: i32) -> Result<Vec<Polygon<f64>>, BlobError> {
    let polygons = decode(blob, srs_id, GeometryKind::Polygon)?.polygons;
    if polygons.is_empty() {
        Err(BlobError::Empty)
    } else {
        Ok(polygons)
    }
}

/// A geometry as a package stores it, and its extent: west, south, east, north.
pub type StoredShape = (Vec<u8>, [f64; 4]);

/// The blob of a geometry in reference system `srs_id`.
pub fn encode(geometry: &Geometry<f64>, srs_id: i32) -> Result<StoredShape, BlobError> {
    if let Some((index, c)) = geometry
        .coords_iter()
        .enumerate()
        .find(|(_, c)| !c.x.is_finite() || !c.y.is_finite())
    {
        return Err(BlobError::NotFinite {
            index,
            x: c.x,
            y: c.y,
        });
    }
    let extent = geometry.bounding_rect().ok_or(BlobError::Empty)?;
    let (min, max) = (extent.min(), extent.max());
    let envelope = vec![min.x, max.x, min.y, max.y];
    let blob = geometry
        .to_gpkg_wkb(CoordDimensions::xy(), Some(srs_id), envelope)
        .map_err(BlobError::Damaged)?;
    Ok((blob, [min.x, min.y, max.x, max.y]))
}

fn decode(blob: &[u8], srs_id: i32, expected: GeometryKind) -> Result<Parts, BlobError> {
    let start = || BlobError::Header(blob.iter().take(8).copied().collect());
    let (srs, code, mut wkb) = header(blob).ok_or_else(start)?;
    if srs != srs_id {
        return Err(BlobError::ReferenceSystem {
            expected: srs_id,
            got: srs,
        });
    }
    // The thousands say the dimensions. Only these kinds are read: collections could nest without
    // end.
    let kind = match code % 1000 {
        2 | 5 => Some(GeometryKind::Line),
        3 | 6 => Some(GeometryKind::Polygon),
        _ => None,
    };
    if kind != Some(expected) {
        return Err(BlobError::Kind {
            expected,
            got: code,
        });
    }
    let mut parts = Parts::default();
    let read = process_wkb_geom(&mut wkb, &mut parts);
    match parts.not_finite {
        Some((index, c)) => Err(BlobError::NotFinite {
            index,
            x: c.x,
            y: c.y,
        }),
        None => read.map(|()| parts).map_err(BlobError::Damaged),
    }
}

/// The reference system of a blob, the code of its geometry type, and its well-known binary.
fn header(blob: &[u8]) -> Option<(i32, u32, &[u8])> {
    let (&[b'G', b'P', 0, flags, s0, s1, s2, s3], rest) = blob.split_first_chunk()? else {
        return None;
    };
    let envelope = *ENVELOPE_BYTES
        .get(usize::from(flags >> 1 & 0b111))
        .filter(|_| flags & EXTENDED == 0)?;
    let wkb = rest.get(envelope..)?;
    let &[order, c0, c1, c2, c3] = wkb.first_chunk()?;
    let (srs, code) = ([s0, s1, s2, s3], [c0, c1, c2, c3]);
    let srs = if flags & LITTLE_ENDIAN == 0 {
        i32::from_be_bytes(srs)
    } else {
        i32::from_le_bytes(srs)
    };
    let code = if order == 0 {
        u32::from_be_bytes(code)
    } else {
        u32::from_le_bytes(code)
    };
    Some((srs, code, wkb))
}

/// Collects the lines or polygons of a blob. geozero's own `GeoWriter` reserves memory by the
/// counts of the blob.
#[derive(Debug, Default)]
struct Parts {
    lines: Vec<LineString<f64>>,
    polygons: Vec<Polygon<f64>>,
    /// Vertices of the line or ring being read.
    vertices: Vec<Coord<f64>>,
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
            return Err(GeozeroError::Geometry(
                "a coordinate is not finite".to_owned(),
            ));
        }
        self.read += 1;
        self.vertices.push(coord);
        Ok(())
    }

    fn linestring_end(&mut self, _: bool, _: usize) -> geozero::error::Result<()> {
        let vertices = std::mem::take(&mut self.vertices);
        if !vertices.is_empty() {
            self.rings
                .as_mut()
                .unwrap_or(&mut self.lines)
                .push(LineString(vertices));
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
    use crate::nuplan::projection::WGS84;
    use geo::{MultiLineString, MultiPolygon};
    use proptest::prelude::*;

    fn square(side: f64) -> LineString<f64> {
        LineString::from(vec![
            (0.0, 0.0),
            (side, 0.0),
            (side, side),
            (0.0, side),
            (0.0, 0.0),
        ])
    }

    /// A blob with the numbers of its header and its well-known binary in one byte order.
    fn blob(little: bool, envelope: u8, wkb: impl Fn(&mut dyn FnMut(Number))) -> Vec<u8> {
        let mut bytes = vec![b'G', b'P', 0, envelope << 1 | u8::from(little)];
        let mut put = |number: Number| match number {
            Number::Byte(b) => bytes.push(b),
            Number::Int(i) => bytes.extend(if little {
                i.to_le_bytes()
            } else {
                i.to_be_bytes()
            }),
            Number::Float(f) => bytes.extend(if little {
                f.to_le_bytes()
            } else {
                f.to_be_bytes()
            }),
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
                    assert_eq!(
                        decode_line(&blob, WGS84).unwrap(),
                        expected,
                        "{little} {envelope} {code}"
                    );
                }
            }
        }
    }

    fn encoded(geometry: impl Into<Geometry<f64>>) -> Vec<u8> {
        encode(&geometry.into(), WGS84).unwrap().0
    }

    #[test]
    fn what_is_written_reads_back() {
        assert_eq!(
            decode_line(&encoded(square(2.0)), WGS84).unwrap(),
            square(2.0)
        );
        let holed = Polygon::new(square(4.0), vec![square(1.0)]);
        let blob = encoded(holed.clone());
        assert_eq!(blob[..4], [b'G', b'P', 0, 0b11]);
        assert_eq!(
            decode_polygons(&blob, WGS84).unwrap(),
            std::slice::from_ref(&holed)
        );
        let several = MultiPolygon(vec![holed, Polygon::new(square(9.0), vec![])]);
        assert_eq!(
            decode_polygons(&encoded(several.clone()), WGS84).unwrap(),
            several.0
        );
        assert_eq!(
            encode(&several.into(), WGS84).unwrap().1.map(f64::to_bits),
            [0.0_f64, 0.0, 9.0, 9.0].map(f64::to_bits)
        );
        let lines = MultiLineString(vec![square(1.0), square(2.0)]);
        assert!(matches!(
            decode_line(&encoded(lines), WGS84),
            Err(BlobError::Parts(2))
        ));
    }

    #[test]
    fn every_fault_has_its_error() {
        let good = encoded(square(2.0));
        let with = |place: usize, byte: u8| {
            let mut blob = good.clone();
            blob[place] = byte;
            decode_line(&blob, WGS84).unwrap_err()
        };
        for (place, byte) in [(0, b'X'), (2, 7), (3, 0b1011), (3, 0b10_0011)] {
            assert!(matches!(with(place, byte), BlobError::Header(start) if start[place] == byte));
        }
        assert!(matches!(
            decode_line(&good, 3857),
            Err(BlobError::ReferenceSystem {
                expected: 3857,
                got: 4326
            })
        ));
        assert!(matches!(
            decode_polygons(&good, WGS84),
            Err(BlobError::Kind {
                expected: GeometryKind::Polygon,
                got: 2
            })
        ));
        assert!(matches!(
            decode_line(&good[..20], WGS84),
            Err(BlobError::Header(_))
        ));
        assert!(matches!(decode_line(&[], WGS84), Err(BlobError::Header(_))));
        assert!(matches!(
            decode_line(&good[..good.len() - 1], WGS84),
            Err(BlobError::Damaged(_))
        ));
        assert!(matches!(
            encode(&MultiPolygon(vec![]).into(), WGS84),
            Err(BlobError::Empty)
        ));
        let nan = LineString::from(vec![(0.0, 0.0), (f64::NAN, 1.0)]);
        assert!(matches!(
            encode(&nan.into(), WGS84),
            Err(BlobError::NotFinite { index: 1, .. })
        ));
        let mut blob = good.clone();
        let second = 8 + 32 + 9 + 16;
        blob[second..second + 8].copy_from_slice(&f64::NAN.to_le_bytes());
        assert!(matches!(
            decode_line(&blob, WGS84),
            Err(BlobError::NotFinite { index: 1, .. })
        ));
    }

    #[test]
    fn counts_are_not_trusted_and_nothing_nests() {
        let endless = |code: u32| {
            blob(true, 0, move |put| {
                put(Number::Int(code));
                put(Number::Int(u32::MAX));
            })
        };
        for code in [2, 5] {
            assert!(matches!(
                decode_line(&endless(code), WGS84),
                Err(BlobError::Damaged(_))
            ));
        }
        for code in [3, 6] {
            assert!(matches!(
                decode_polygons(&endless(code), WGS84),
                Err(BlobError::Damaged(_))
            ));
        }
        let mut deep = endless(7);
        (0..100_000).for_each(|_| deep.extend([1, 7, 0, 0, 0, 1, 0, 0, 0]));
        assert!(matches!(
            decode_line(&deep, WGS84),
            Err(BlobError::Kind { got: 7, .. })
        ));
        let empty = blob(true, 0, |put| {
            put(Number::Int(3));
            put(Number::Int(0));
        });
        assert!(matches!(
            decode_polygons(&empty, WGS84),
            Err(BlobError::Empty)
        ));
    }

    proptest! {
        #[test]
        fn reading_never_panics(bytes in prop::collection::vec(any::<u8>(), 0..200), place in 0usize..200, header: bool) {
            let mut blob = bytes.clone();
            if header {
                blob = encoded(Polygon::new(square(4.0), vec![square(1.0)]));
                let at = place % blob.len();
                blob.splice(at..at, bytes.iter().copied().take(3));
                blob.truncate(200 + place);
            }
            let _ = decode_line(&blob, WGS84).is_ok();
            let _ = decode_polygons(&blob, WGS84).is_ok();
        }

        #[test]
        fn any_polygon_comes_back(ring in prop::collection::vec((-180.0..180.0f64, -90.0..90.0f64), 3..40)) {
            let polygon = Polygon::new(LineString::from(ring), vec![]);
            prop_assert_eq!(decode_polygons(&encoded(polygon.clone()), WGS84).unwrap(), [polygon]);
        }
    }
}
