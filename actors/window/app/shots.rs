//! Screenshots (F12): the picture as it is on show, with everything that it takes to make it again.
//!
//! Where an adapter draws the picture it comes back through a ring of buffers, so that no frame waits for it.

use foveal::image::Map2d;

use super::App;
use foveal_engine::screenshot;

/// A picture on its way back from the adapter.
pub(super) struct Asked {
    tag: u64,
    facts: Vec<(String, String)>,
}

impl App {
    /// Saves the picture on show, or asks the adapter for it.
    pub(super) fn screenshot(&mut self) {
        let now = self.now();
        let (Some(walk), Some(screen)) = (&mut self.walk, &mut self.screen) else { return };
        let mut facts = walk.facts(now);
        if walk.is_mirrored()
            && let Some(mirror) = screen.presenter.mirror()
        {
            facts.push(("foveal drawn by".into(), mirror.gpu().info.to_string()));
            match mirror.request_picture() {
                Some(tag) => self.asked.push(Asked { tag, facts }),
                None => walk.complain("no screenshot: three are on their way".into()),
            }
            return;
        }
        // A recording may have gone elsewhere since it was last painted.
        if walk.timeline().is_some() {
            walk.fetch_picture();
        }
        if let Some(picture) = walk.picture().cloned() {
            self.save(&picture, &facts);
        }
    }

    fn save(&mut self, picture: &Map2d<[u8; 3]>, facts: &[(String, String)]) {
        let saved = screenshot::png(picture, facts)
            .and_then(|bytes| screenshot::save(&self.options.screenshots, &bytes));
        let Some(walk) = &mut self.walk else { return };
        match saved {
            Ok(path) => walk.tell(format!("{} written", path.display())),
            Err(e) => walk.complain(e),
        }
        self.request_redraw();
    }

    /// Saves what has arrived. Whether some is still on its way.
    pub(super) fn collect_shots(&mut self) -> bool {
        while !self.asked.is_empty()
            && let Some(mirror) = self.screen.as_mut().and_then(|s| s.presenter.mirror())
            && let Some((tag, [width, height], bytes)) = mirror.poll_picture()
        {
            let Some(at) = self.asked.iter().position(|asked| asked.tag == tag) else { continue };
            let asked = self.asked.remove(at);
            let rgb = bytes.chunks_exact(4).map(|p| [p[0], p[1], p[2]]).collect();
            let picture = Map2d::from_vec(width as usize, height as usize, rgb);
            self.save(&picture, &asked.facts);
        }
        !self.asked.is_empty()
    }

    /// The adapter is gone and what it had; the processor's picture is the same.
    pub(super) fn shots_were_lost(&mut self) {
        for asked in std::mem::take(&mut self.asked) {
            let Some(walk) = &mut self.walk else { return };
            walk.fetch_picture();
            if let Some(picture) = walk.picture().cloned() {
                self.save(&picture, &asked.facts);
            }
        }
    }
}
