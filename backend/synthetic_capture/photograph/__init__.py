"""What a rendered capture has in common with photos that people take: the effects of `synthetic.py --photograph`."""
