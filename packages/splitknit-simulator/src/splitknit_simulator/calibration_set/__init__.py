"""What a person puts under the rig to calibrate it: cards, boards, nail and ball, photographed by
the simulator."""
