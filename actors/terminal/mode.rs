//! What is kept where time is short: the frame rate or the quality (Dumont 2003, figure 17).

use clap::{Args, ValueEnum};

/// Arguments of the mode.
#[derive(Args, Clone, Copy, Debug)]
pub struct ModeArguments {
    /// What is kept when time is short: the frame rate, whatever the picture looks like, or the quality, while the frame
    /// rate drops
    #[arg(long, value_enum, default_value_t = Mode::FixedRate)]
    mode: Mode,
    /// With --mode fixed-quality: the least quality of a frame that is shown, which is minus the mean visible error of its
    /// pixels in just noticeable differences; 0 is a picture without error
    #[arg(long, value_name = "Q", default_value = "-0.25", allow_negative_numbers = true, value_parser = quality)]
    quality: f32,
}

impl ModeArguments {
    /// The name of the mode.
    pub fn name(&self) -> &'static str {
        match self.mode {
            Mode::FixedRate => "fixed-rate",
            Mode::FixedQuality => "fixed-quality",
        }
    }

    /// The least quality of a frame that is shown; `None` where frames keep their rate.
    pub fn least_quality(&self) -> Option<f32> {
        match self.mode {
            Mode::FixedRate => None,
            Mode::FixedQuality => Some(self.quality),
        }
    }
}

/// What is kept where time is short.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Mode {
    /// Frames come at their rate, as good as they are
    FixedRate,
    /// Frames wait until they are good enough
    FixedQuality,
}

/// A quality, at most 0.
fn quality(text: &str) -> Result<f32, String> {
    let value: f32 = text.parse().map_err(|_| format!("{text} is no number"))?;
    if value <= 0.0 { Ok(value) } else { Err("no picture is better than 0, the one without errors".into()) }
}
