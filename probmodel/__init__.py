"""What is believed about a pose and its detection: skeleton, anatomical limits, distributions,
camera, the model.

detections = probmodel.read_detections("frame_keypoints.json")
model = probmodel.PoseModel(limits=probmodel.AnatomicalLimits.default())
"""

import lazy_loader

# Every name stands in `__init__.pyi` and is looked up when first used: what a command does not need
# it does not wait for.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
