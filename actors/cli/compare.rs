//! `foveal compare A B`: how two pictures differ.

use std::path::PathBuf;

use clap::Args;
use serde_json::json;

use foveal::display::tone::{ToneCurve, ToneMap};
use foveal::image::Map2d;
use foveal::metrics::{self, heat::heat_map};

use super::arguments::{positive, share};
use super::failure::Failure;
use super::output::{png_bytes, print_json, print_line, read_picture, write_atomic};

/// Arguments of `foveal compare`.
#[derive(Args, Debug)]
pub struct CompareArguments {
    /// The picture to judge (PNG, JPEG, HDR or EXR)
    test: PathBuf,
    /// The picture it should be
    reference: PathBuf,
    /// Factor on linear pictures before they are shown
    #[arg(long, default_value = "1", value_parser = positive)]
    exposure: f32,
    /// Write a heat map of FLIP (black: none, white: largest)
    #[arg(long, value_name = "FILE.png")]
    heat: Option<PathBuf>,
    /// Exit with 1 if the mean FLIP is above this, e.g. 5%
    #[arg(long, value_name = "SHARE", value_parser = share)]
    max_flip: Option<f32>,
    /// One JSON document
    #[arg(long)]
    json: bool,
}

/// Runs the command.
pub fn run(a: &CompareArguments) -> Result<(), Failure> {
    let (test, reference) = (read_picture(&a.test)?, read_picture(&a.reference)?);
    let tone = ToneMap { exposure: a.exposure, curve: ToneCurve::Clamp };
    let c = metrics::compare(&test, &reference, &tone)
        .map_err(|e| Failure::Input(format!("{} and {}: {e}", a.test.display(), a.reference.display())))?;
    if let Some(path) = &a.heat {
        let heat: Map2d<[u8; 3]> = heat_map(&c.flip_map);
        let bytes: Vec<u8> = heat.data().as_flattened().to_vec();
        write_atomic(path, &png_bytes(heat.width() as u32, heat.height() as u32, &bytes)?)?;
    }
    if a.json {
        print_json(&json!({
            "schema": "foveal.compare/1",
            "flip": c.flip,
            "psnr": c.psnr,
            "relmse": c.linear.relmse,
            "relmse_trimmed": c.linear.relmse_trimmed,
            "relmse_median": c.linear.relmse_median,
            "smape": c.linear.smape,
            "max_abs": c.linear.max_abs,
            "delta_e": c.delta_e,
            "not_finite": c.linear.not_finite,
            "identical": c.identical,
        }));
    } else {
        if c.identical {
            print_line("identical, bit for bit");
        }
        print_line(&format!("FLIP     {:.6}", c.flip));
        print_line(
            &c.psnr.map_or("PSNR     – (identical as shown)".into(), |p| format!("PSNR     {p:.2} dB")),
        );
        print_line(&format!(
            "relMSE   {:.6e}  without the worst 0.1 %: {:.6e}",
            c.linear.relmse, c.linear.relmse_trimmed
        ));
        print_line(&format!("max |Δ|  {:.6e}", c.linear.max_abs));
        print_line(&format!("ΔE*ab    {:.4}", c.delta_e));
        if c.linear.not_finite > 0 {
            print_line(&format!("{} values are NaN or infinite", c.linear.not_finite));
        }
    }
    match a.max_flip {
        Some(bound) if c.flip > f64::from(bound) => {
            Err(Failure::Check(format!("FLIP {:.6} is above {bound}", c.flip)))
        }
        _ => Ok(()),
    }
}
