//! Films of a simulation: GIF, and MP4 by ffmpeg.

use super::error::{OutputFault, RenderError};
use super::frame::Film;
use super::palette;
use crate::report::ReportError;
use crate::report::atomic;
use gif::{Encoder, Repeat};
use image::RgbImage;
use planagent_child::BoundChild;
use planagent_files::WholeFile;
use planagent_world::STEP_S;
use rayon::prelude::*;
use std::io::{Read, Write};
use std::num::NonZeroU32;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

/// Frames that are drawn in parallel.
const BATCH: usize = 16;
/// Time of the last frame of a GIF before it repeats.
const REST: Duration = Duration::from_millis(1500);

/// Writes a GIF that repeats forever. A frame holds only the pixels that change.
pub fn write_gif(
    film: &Film,
    frames_per_s: NonZeroU32,
    path: &Path,
    on_frame: &dyn Fn(),
) -> Result<(), RenderError> {
    let failed = RenderError::output(path);
    let iterations = iterations(film, frames_per_s);
    let (width, height) = film.frame(0).dimensions();
    let side =
        |side| u16::try_from(side).map_err(|_| RenderError::output(path)(OutputFault::TooLarge));
    let (width, height) = (side(width)?, side(height)?);
    let mut bytes = Vec::new();
    {
        let mut encoder = Encoder::new(&mut bytes, width, height, &[]).map_err(&failed)?;
        encoder.set_repeat(Repeat::Infinite).map_err(&failed)?;
        let mut last: Option<RgbImage> = None;
        // Frames are drawn on all cores and encoded in order; batches bound the memory between the
        // two.
        for batch in iterations.chunks(BATCH) {
            for (drawn, iteration) in drawn(film, batch).into_iter().zip(batch) {
                let is_last = iterations.last() == Some(iteration);
                let shown = if is_last {
                    REST
                } else {
                    Duration::from_secs(1) / frames_per_s.get()
                };
                let mut frame = palette::frame(last.as_ref(), &drawn, (width, height));
                frame.delay = u16::try_from(shown.as_millis() / 10).unwrap_or(u16::MAX);
                encoder.write_frame(&frame).map_err(&failed)?;
                last = Some(drawn);
                on_frame();
            }
        }
    }
    Ok(atomic::write(path, &bytes)?)
}

/// Writes an MP4 (H.264) through ffmpeg.
pub fn write_mp4(
    film: &Film,
    frames_per_s: NonZeroU32,
    path: &Path,
    on_frame: &dyn Fn(),
) -> Result<(), RenderError> {
    let iterations = iterations(film, frames_per_s);
    let (width, height) = film.frame(0).dimensions();
    let size = format!("{width}x{height}");
    let rate = frames_per_s.to_string();
    // What ffmpeg leaves when it is interrupted is a valid film of a part.
    let file = WholeFile::create(path).map_err(ReportError::write(path))?;
    let mut command = Command::new("ffmpeg");
    command.args([
        "-loglevel",
        "error",
        "-y",
        "-f",
        "rawvideo",
        "-pix_fmt",
        "rgb24",
        "-s",
        &size,
        "-r",
        &rate,
    ]);
    command.args([
        "-i",
        "-",
        "-c:v",
        "libx264",
        "-pix_fmt",
        "yuv420p",
        "-movflags",
        "+faststart",
        "-f",
        "mp4",
    ]);
    command
        .arg(std::path::absolute(file.temporary_path()).map_err(ReportError::write(path))?)
        .stdin(Stdio::piped())
        .stdout(Stdio::null())
        .stderr(Stdio::piped());
    let mut bound = BoundChild::spawn(&mut command).map_err(RenderError::NoFfmpeg)?;
    let ffmpeg = bound.process();
    let mut input = ffmpeg.stdin.take();
    'film: for batch in iterations.chunks(BATCH) {
        for frame in drawn(film, batch) {
            // If ffmpeg ends early, its error output says why.
            if input
                .as_mut()
                .is_none_or(|input| input.write_all(frame.as_raw()).is_err())
            {
                break 'film;
            }
            on_frame();
        }
    }
    drop(input);
    let mut message = String::new();
    if let Some(mut output) = ffmpeg.stderr.take() {
        // Error output that is not UTF-8 is of no use.
        let _ = output.read_to_string(&mut message);
    }
    let ended = ffmpeg.wait().map_err(ReportError::write(path))?;
    planagent_child::wait_if_ending();
    if ended.success() {
        return Ok(file.finish().map_err(ReportError::write(path))?);
    }
    Err(RenderError::output(path)(OutputFault::Ffmpeg(
        message.trim().to_owned(),
    )))
}

/// The iterations of the frames, with the last iteration.
fn iterations(film: &Film, frames_per_s: NonZeroU32) -> Vec<usize> {
    let last = film.iterations().saturating_sub(1);
    let a_frame = 1.0 / (f64::from(frames_per_s.get()) * STEP_S);
    let count = (last as f64 / a_frame).ceil() as usize;
    let at = |k: usize| (k as f64 * a_frame).round() as usize;
    let mut iterations: Vec<usize> = (0..count)
        .map(at)
        .filter(|&iteration| iteration < last)
        .collect();
    iterations.push(last);
    iterations
}

fn drawn(film: &Film, iterations: &[usize]) -> Vec<RgbImage> {
    iterations
        .par_iter()
        .map(|&iteration| film.frame(iteration))
        .collect()
}
