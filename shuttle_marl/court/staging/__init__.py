"""From a played rally to motion: one staging, for every renderer.

``stage(rally, seed=…)`` gives the path of the shuttle and the bones of both players, 50 times a second, in the frame of the
court: metres, seconds, z up, the origin on the floor under the middle of the net, seat 0 at y < 0 looking towards +y, unless
the players have changed ends. The same arguments give the same motion. ``docs/staging.md`` shows how a renderer uses it;
``athletes/`` holds the skinned models, and ``load_skeleton`` gives their rest pose, bone by bone.
"""

from shuttle_marl.court.staging.motion import Motion, continue_motion, stage
from shuttle_marl.court.staging.skeleton import BONES, StagingError, load_skeleton, model_file
from shuttle_marl.court.staging.trajectory import ENDS

__all__ = ["BONES", "ENDS", "Motion", "StagingError", "continue_motion", "load_skeleton", "model_file", "stage"]
