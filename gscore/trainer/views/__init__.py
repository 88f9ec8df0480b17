"""What is learnt of each photo beside the splats, and from which facts: how it was exposed."""
