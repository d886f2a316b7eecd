//! A frame as it was shown.

use std::collections::HashMap;
use std::sync::Arc;

use foveal::splatting::supersampling::Tiles;
use foveal_actors::insight::Insight;
use foveal_actors::message::FrameSnapshot;
use foveal_actors::renderer::{FrameCounts, Renderer};
use foveal_engine::foveal::display::tone::ToneMap;
use foveal_engine::{Event, Standing};
use numpy::{PyArray2, PyArray3};
use pyo3::prelude::*;

use crate::camera::Camera;
use crate::pictures::{array2, array3};

/// What is known of a frame.
#[pyclass(frozen, module = "foveal")]
pub struct Frame {
    snapshot: Arc<FrameSnapshot>,
    camera: Option<Camera>,
    counts: FrameCounts,
    standing: Standing,
    stages: HashMap<&'static str, f64>,
    events: Vec<String>,
    seconds: Option<f64>,
    known: Known,
}

/// Errors as the allocator and the renderer estimate them.
#[derive(Clone, Default)]
pub struct Known {
    /// By object id, just noticeable differences; NaN where nothing is known.
    objects: Vec<f32>,
    /// By tile of a refined view, standard error of displayed values; NaN for the others.
    tiles: Vec<f32>,
    quality: Option<f32>,
}

impl Known {
    /// What is known of the view that `renderer` shows.
    pub fn new(renderer: Option<&Renderer>, insight: Option<&Insight>, tone: &ToneMap) -> Self {
        let Some(renderer) = renderer else { return Self::default() };
        let view = renderer.drawn().map(|drawn| drawn.view);
        let insight = insight.filter(|insight| Some(insight.view) == view);
        let of_object =
            |(id, o): (usize, &foveal_actors::insight::ObjectInsight)| match (id, renderer.is_converged()) {
                (0, _) | (_, true) => 0.0,
                _ => o.error.unwrap_or(f32::NAN),
            };
        let objects = insight.map(|i| i.objects.iter().enumerate().map(of_object).collect());
        let mut tiles = Vec::new();
        for sums in renderer.tiles() {
            let index = sums.tile as usize;
            tiles.resize(tiles.len().max(index + 1), f32::NAN);
            tiles[index] = sums.error(tone)[0];
        }
        let quality = match renderer.is_converged() {
            true => Some(0.0),
            false => insight.map(|i| i.quality),
        };
        Self { objects: objects.unwrap_or_default(), tiles, quality: quality.filter(|q| q.is_finite()) }
    }
}

impl Frame {
    /// A frame that was shown live.
    pub fn shown(frame: &foveal_engine::Frame, camera: Camera, seconds: f64, known: Known) -> Self {
        let event = |event: &Event| match event {
            Event::LightGrew => "the light grew".to_owned(),
            Event::LightFinal => "the light is final".to_owned(),
            Event::Converged => "the view has converged".to_owned(),
            Event::Refined => "the view is refined".to_owned(),
            Event::RecordingStopped { reason } => format!("the recording stopped: {reason}"),
            Event::Incident { what } => what.clone(),
        };
        Self {
            snapshot: Arc::clone(&frame.snapshot),
            camera: Some(camera),
            counts: frame.counts,
            standing: frame.standing,
            stages: frame.stages.iter().map(|(stage, time)| (stage.key(), time.as_secs_f64())).collect(),
            events: frame.events.iter().map(event).collect(),
            seconds: Some(seconds),
            known,
        }
    }

    /// A frame of a recording.
    pub fn replayed(
        snapshot: Arc<FrameSnapshot>,
        camera: Option<Camera>,
        standing: Standing,
        known: Known,
    ) -> Self {
        Self {
            snapshot,
            camera,
            counts: FrameCounts::default(),
            standing,
            stages: HashMap::new(),
            events: Vec::new(),
            seconds: None,
            known,
        }
    }

    fn size(&self) -> (usize, usize) {
        (self.snapshot.rgb8.width(), self.snapshot.rgb8.height())
    }
}

#[pymethods]
impl Frame {
    #[getter]
    fn index(&self) -> u32 {
        self.snapshot.index.0
    }

    #[getter]
    fn view(&self) -> u32 {
        self.snapshot.drawn.view.0
    }

    #[getter]
    fn camera(&self) -> Option<Camera> {
        self.camera
    }

    #[getter]
    fn picture<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray3<u8>>> {
        let (width, height) = self.size();
        array3(py, width, height, self.snapshot.rgb8.data().as_flattened().to_vec())
    }

    #[getter]
    fn depth<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let (width, height) = self.size();
        array2(py, width, height, self.snapshot.drawn.buffers().depth.data().to_vec())
    }

    #[getter]
    fn ids<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<u32>>> {
        let (width, height) = self.size();
        array2(py, width, height, self.snapshot.drawn.buffers().object.data().to_vec())
    }

    #[getter]
    fn error<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let (width, height) = self.size();
        let of = |id: &u32| match (id, self.standing) {
            (0, _) | (_, Standing::Converged | Standing::Refined) => 0.0,
            (id, _) => self.known.objects.get(*id as usize).copied().unwrap_or(f32::NAN),
        };
        array2(py, width, height, self.snapshot.drawn.buffers().object.data().iter().map(of).collect())
    }

    #[getter]
    fn noise<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let (width, height) = self.size();
        let tiles = Tiles::of_size(width as u32, height as u32);
        let of = |i: usize| self.known.tiles.get(tiles.at(i % width, i / width)).copied().unwrap_or(f32::NAN);
        array2(py, width, height, (0..width * height).map(of).collect())
    }

    #[getter]
    fn quality(&self) -> Option<f32> {
        self.known.quality
    }

    #[getter]
    fn standing(&self) -> &'static str {
        self.standing.name()
    }

    #[getter]
    fn traced(&self) -> u32 {
        self.counts.traced
    }

    #[getter]
    fn reused(&self) -> u32 {
        self.counts.reused
    }

    #[getter]
    fn expired(&self) -> u32 {
        self.counts.expired
    }

    #[getter]
    fn stages(&self) -> HashMap<&'static str, f64> {
        self.stages.clone()
    }

    #[getter]
    fn events(&self) -> Vec<String> {
        self.events.clone()
    }

    #[getter]
    fn seconds(&self) -> Option<f64> {
        self.seconds
    }

    #[getter]
    fn hash(&self) -> u64 {
        self.snapshot.hash
    }

    fn __repr__(&self) -> String {
        let (width, height) = self.size();
        format!("<foveal.Frame {}, {width} × {height}, {}>", self.index(), self.standing())
    }
}
