//! `foveal compare A B`: how two pictures differ.

use std::path::PathBuf;

use clap::Args;
use serde_json::json;

use foveal::display::tone::{ToneCurve, ToneMap};
use foveal::image::Map2d;
use foveal::metrics::{self, Agreement, Batches, BlockErrors, heat::heat_map};

use foveal_engine::failure::Failure;
use foveal_engine::files::{png_bytes, read_batches, read_picture, write_atomic};
use foveal_terminal::arguments::{positive, share};
use foveal_terminal::print::{print_json, print_line};
use foveal_terminal::table::figure;

/// Arguments of `foveal compare`.
#[derive(Args, Debug)]
pub struct CompareArguments {
    /// Picture to judge (PNG, JPEG, HDR or EXR)
    test: PathBuf,
    /// Reference picture
    reference: PathBuf,
    /// Factor applied to linear pictures before display
    #[arg(long, default_value = "1", value_parser = positive)]
    exposure: f32,
    /// Also compare means of blocks of this many pixels along an edge, in which noise averages out (default: 8), and
    /// of other sizes; if both pictures have .batches.json next to them, also test whether their blocks differ by
    /// more than noise
    #[arg(long, value_name = "PIXELS", num_args = 0..=1, default_missing_value = "8",
        value_parser = clap::value_parser!(u16).range(1..=1024))]
    blocks: Option<u16>,
    /// Write a heat map of FLIP (black: none, white: largest)
    #[arg(long, value_name = "FILE.png")]
    heat: Option<PathBuf>,
    /// Exit with 1 if the mean FLIP is above this, e.g. 5%
    #[arg(long, value_name = "SHARE", value_parser = share)]
    max_flip: Option<f32>,
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

/// Edges of blocks that are told beside the one that was asked for: what falls with them is noise.
const SIZES: [usize; 5] = [4, 8, 16, 32, 64];

/// Runs the command.
pub fn run(a: &CompareArguments) -> Result<(), Failure> {
    let (test, reference) = (read_picture(&a.test)?, read_picture(&a.reference)?);
    let tone = ToneMap { exposure: a.exposure, curve: ToneCurve::Clamp };
    let c = metrics::compare(&test, &reference, &tone)
        .map_err(|e| Failure::Input(format!("{} and {}: {e}", a.test.display(), a.reference.display())))?;
    let of_size = |size: usize| metrics::block_errors(&test, &reference, size);
    let blocks = match a.blocks.map(usize::from) {
        None => None,
        Some(size) => Some(of_size(size).ok_or_else(|| {
            Failure::Usage(format!("--blocks {size}: not one block of that size fits into the pictures"))
        })?),
    };
    let sizes: Vec<BlockErrors> = blocks.iter().flat_map(|_| SIZES).filter_map(of_size).collect();
    let of_noise = |path| if blocks.is_some() { read_batches(path) } else { Ok(None) };
    let noise = [of_noise(&a.test)?, of_noise(&a.reference)?];
    let agreement = match &noise {
        [Some(test), Some(reference)] => Agreement::new(test, reference),
        _ => None,
    };
    let noise = noise.map(|batches| batches.as_ref().map(Batches::relative_error));
    if let Some(path) = &a.heat {
        let heat: Map2d<[u8; 3]> = heat_map(&c.flip_map);
        let bytes: Vec<u8> = heat.data().as_flattened().to_vec();
        write_atomic(path, &png_bytes(heat.width() as u32, heat.height() as u32, &bytes)?)?;
    }
    if a.json {
        let mut document = json!({
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
        });
        if let Some(b) = &blocks {
            let by_size = sizes.iter().map(|s| (s.size.to_string(), json!(s.mean)));
            document["blocks"] = json!({
                "size": b.size,
                "count": b.count,
                "mean": b.mean,
                "over_10_percent": b.over_10_percent,
                "bias": b.bias,
                "mean_by_size": by_size.collect::<serde_json::Map<_, _>>(),
                "noise": { "test": noise[0], "reference": noise[1] },
                "agreement": agreement.map(|z| json!({
                    "holds": z.holds(),
                    "blocks": z.blocks,
                    "mean_square": z.mean_square,
                    "over_3": z.over_3,
                    "together": z.together,
                    "largest": z.largest.is_finite().then_some(z.largest),
                    "of_largest": z.of_largest,
                })),
            });
        }
        print_json(&document);
    } else {
        if c.identical {
            print_line("identical, bit for bit");
        }
        print_line(&format!("FLIP     {}", figure(c.flip)));
        print_line(&match c.psnr {
            Some(psnr) => format!("PSNR     {} dB", figure(psnr)),
            None => "PSNR     – (identical as shown)".into(),
        });
        print_line(&format!(
            "relMSE   {}, without the worst 0.1 % of the pixels {}",
            figure(c.linear.relmse),
            figure(c.linear.relmse_trimmed)
        ));
        print_line(&format!("max |Δ|  {}", figure(c.linear.max_abs)));
        print_line(&format!("ΔE*ab    {}", figure(c.delta_e)));
        if let Some(b) = &blocks {
            let percent = |share: f64| format!("{} %", figure(100.0 * share));
            print_line(&format!(
                "blocks   of {} × {} pixels: {} off on average, {} of them by more than 10 %; all together {}{}",
                b.size,
                b.size,
                percent(b.mean),
                percent(b.over_10_percent),
                if b.bias > 0.0 { "+" } else { "" },
                percent(b.bias)
            ));
            let by_size = sizes.iter().map(|s| format!("{}: {}", s.size, percent(s.mean)));
            print_line(&format!("         by size {}", by_size.collect::<Vec<_>>().join(", ")));
            for (noise, path) in noise.iter().zip([&a.test, &a.reference]) {
                if let Some(noise) = noise {
                    print_line(&format!("noise    {} in {}", percent(*noise), path.display()));
                }
            }
        }
        if let Some(z) = &agreement {
            print_line(&format!(
                "z        of {} blocks: mean square {}, above 3 {} %, together {} standard errors, largest {} (p = {}): {}",
                z.blocks,
                figure(z.mean_square),
                figure(100.0 * z.over_3),
                figure(z.together),
                figure(z.largest),
                figure(z.of_largest),
                if z.holds() { "they differ by noise alone" } else { "they differ by more than noise" }
            ));
        }
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
