"""The lumen from inside: what a camera at the instrument's tip would see along the path, and where to turn."""

from tubeplan_viz.endoluminal.camera import Camera, path_cameras
from tubeplan_viz.endoluminal.film import Film, FilmSettings, Still, film_stills, make_film
from tubeplan_viz.endoluminal.render import Interior
from tubeplan_viz.endoluminal.steps import WalkStep, clock, patient_words, walk_steps

__all__ = [
    "Camera",
    "Film",
    "FilmSettings",
    "Interior",
    "Still",
    "WalkStep",
    "clock",
    "film_stills",
    "make_film",
    "path_cameras",
    "patient_words",
    "walk_steps",
]
