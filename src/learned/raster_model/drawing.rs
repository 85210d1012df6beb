//! Draws as OpenCV 4.5 does on an image of floats, pixel for pixel: polygons and lines of
//! fixed-point vertices, without smoothing.

/// Bits of the fraction while drawing.
const FRACTION: u32 = 16;
const ONE: i64 = 1 << FRACTION;
const HALF: i64 = ONE / 2;

/// A vertex: column and row in fixed point.
pub type Vertex = [i64; 2];

/// An image of one channel, rows from top to bottom.
#[derive(Debug, Clone, PartialEq)]
pub struct Canvas {
    /// Columns and rows.
    pub side: usize,
    /// The values, row by row.
    pub pixels: Vec<f32>,
}

/// An edge of a polygon between two rows.
struct Edge {
    rows: std::ops::Range<i64>,
    x: i64,
    slope: i64,
}

impl Canvas {
    /// Zeros.
    pub fn new(side: usize) -> Self {
        Self {
            side,
            pixels: vec![0.0; side * side],
        }
    }

    fn put(&mut self, column: i64, row: i64, value: f32) {
        let inside = |place: i64| {
            usize::try_from(place)
                .ok()
                .filter(|&place| place < self.side)
        };
        if let (Some(column), Some(row)) = (inside(column), inside(row)) {
            self.pixels[row * self.side + column] = value;
        }
    }

    /// Fills a rectangle, both corners included.
    pub fn rectangle(&mut self, columns: [i64; 2], rows: [i64; 2], value: f32) {
        for row in rows[0]..=rows[1] {
            for column in columns[0]..=columns[1] {
                self.put(column, row, value);
            }
        }
    }

    /// Fills a polygon (`cv2.fillPoly`), whose vertices have `shift` bits of fraction.
    pub fn polygon(&mut self, vertices: &[Vertex], shift: u32, value: f32) {
        let Some(&last) = vertices.last() else { return };
        let scaled = |[x, y]: Vertex| [x << (FRACTION - shift), (y + (1 << shift >> 1)) >> shift];
        let mut before = scaled(last);
        let mut edges = Vec::with_capacity(vertices.len());
        for &vertex in vertices {
            let now = scaled(vertex);
            // As OpenCV: spans leave out parts of thin polygons, which the outline adds.
            self.border(
                [before, now].map(|[x, y]| [(x + HALF) >> FRACTION, y]),
                value,
            );
            if before[1] != now[1] {
                let slope = (now[0] - before[0]) / (now[1] - before[1]);
                let [upper, lower] = if before[1] < now[1] {
                    [before, now]
                } else {
                    [now, before]
                };
                edges.push(Edge {
                    rows: upper[1]..lower[1],
                    x: upper[0],
                    slope,
                });
            }
            before = now;
        }
        for row in 0..self.side as i64 {
            let active = edges.iter().filter(|edge| edge.rows.contains(&row));
            let mut crossings: Vec<i64> = active
                .map(|edge| edge.x + (row - edge.rows.start) * edge.slope)
                .collect();
            crossings.sort_unstable();
            for pair in crossings.chunks_exact(2) {
                let (from, to) = ((pair[0] + ONE - 1) >> FRACTION, pair[1] >> FRACTION);
                for column in from.max(0)..=to.min(self.side as i64 - 1) {
                    self.put(column, row, value);
                }
            }
        }
    }

    /// A line of whole pixels, its ends included.
    fn border(&mut self, ends: [[i64; 2]; 2], value: f32) {
        let Some([mut from, mut to]) = clipped(ends, self.side as i64 - 1) else {
            return;
        };
        // Always from left to right, as OpenCV: ties round to other pixels in the other direction.
        if to[0] < from[0] {
            (from, to) = (to, from);
        }
        let (mut major, mut minor) = (to[0] - from[0], (to[1] - from[1]).abs());
        let down = if to[1] < from[1] { -1 } else { 1 };
        let steep = minor > major;
        if steep {
            (major, minor) = (minor, major);
        }
        let mut error = major - 2 * minor;
        let [mut x, mut y] = from;
        for _ in 0..=major {
            self.put(x, y, value);
            let turns = error < 0;
            error += if turns {
                2 * major - 2 * minor
            } else {
                -2 * minor
            };
            if steep || turns {
                y += down;
            }
            if !steep || turns {
                x += 1;
            }
        }
    }

    /// An open line of one pixel's width (`cv2.polylines`), whose vertices have `shift` bits of
    /// fraction.
    pub fn line(&mut self, vertices: &[Vertex], shift: u32, value: f32) {
        for pair in vertices.windows(2) {
            let ends =
                [pair[0], pair[1]].map(|vertex| vertex.map(|place| place << (FRACTION - shift)));
            self.segment(ends, value);
        }
    }

    fn segment(&mut self, ends: [[i64; 2]; 2], value: f32) {
        let Some([mut from, mut to]) = clipped(ends, ((self.side as i64) << FRACTION) - 1) else {
            return;
        };
        let along = [to[0] - from[0], to[1] - from[1]].map(i64::abs);
        // The axis that a pixel is drawn for at each step.
        let (axis, other) = if along[0] > along[1] { (0, 1) } else { (1, 0) };
        if to[axis] < from[axis] {
            (from, to) = (to, from);
        }
        let step = ((to[other] - from[other]) << FRACTION) / (along[axis] | 1);
        let count = (to[axis] - from[axis]) >> FRACTION;
        self.put(
            (to[0] + HALF) >> FRACTION,
            (to[1] + HALF) >> FRACTION,
            value,
        );
        let (mut place, mut side) = ((from[axis] + HALF) >> FRACTION, from[other] + HALF);
        for _ in 0..=count {
            let [x, y] = if axis == 0 {
                [place, side >> FRACTION]
            } else {
                [side >> FRACTION, place]
            };
            self.put(x, y, value);
            place += 1;
            side += step;
        }
    }
}

/// The part of a segment inside [0, last] on both axes, by OpenCV's rules; `None` where there is
/// none.
fn clipped([mut from, mut to]: [[i64; 2]; 2], last: i64) -> Option<[[i64; 2]; 2]> {
    let outside = |point: [i64; 2], axis: usize| point[axis] < 0 || point[axis] > last;
    let beyond = |a: [i64; 2], b: [i64; 2], axis: usize| {
        (a[axis] < 0 && b[axis] < 0) || (a[axis] > last && b[axis] > last)
    };
    for axis in [1, 0] {
        if beyond(from, to, axis) || (axis == 1 && beyond(from, to, 0)) {
            return None;
        }
        let other = 1 - axis;
        let border = |place: i64| if place < 0 { 0 } else { last };
        let moved = |point: [i64; 2], from: [i64; 2], to: [i64; 2]| {
            let at = border(point[axis]);
            let slope = (at - point[axis]) as f64 * (to[other] - from[other]) as f64;
            let mut point = point;
            point[other] += (slope / (to[axis] - from[axis]) as f64) as i64;
            point[axis] = at;
            point
        };
        if outside(from, axis) {
            from = moved(from, from, to);
        }
        if outside(to, axis) {
            to = moved(to, from, to);
        }
    }
    (!outside(from, 0) && !outside(to, 0)).then_some([from, to])
}
