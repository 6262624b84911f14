"""What bounds a pad: its plane faces, what lies on each, and what that does to light."""

from render.pad.faces import PlaneFace, mirror_faces, outline, plane_faces, walls

__all__ = ["PlaneFace", "mirror_faces", "outline", "plane_faces", "walls"]
