import json,sys
import numpy as np
def load(f): return [json.loads(l) for l in open(f)]
R=load(sys.argv[1])
taus=[.6,.7,.8,.85,.9,1.0,1.1,1.2]
tab=[]
for r in R:
    e=np.array([q["e"] for q in r["rows"]]); err=np.array([q["err"] for q in r["rows"]]); chi=np.array([q["chi"] for q in r["rows"]])
    m=err.min(); row=[]
    for t in taus:
        # strongest with chi<=t, log-interp
        k=np.argmax(chi<=t) if (chi<=t).any() else len(chi)-1
        if k>0 and chi[k]<=t:
            f=(np.log(chi[k-1])-np.log(t))/(np.log(chi[k-1])-np.log(chi[k])); er=np.exp(np.log(err[k-1])*(1-f)+np.log(err[k])*f)
        else: er=err[k]
        row.append(er/m)
    kb=int(err.argmin())
    print(f"{r['seed']:3d} {r['family']:10s} v{r['views']:4d} ph {r['photons'] and round(r['photons'])} nv/m2 {r['nv']/r['m2']:.2f} m2/mua2 {r['m2']/r['mua2']:.3f} chi_t {r['chi_t']:.2f} chi_best {chi[kb]:.2f} best/sart {m/r['sart'][0]:.2f} fast/best {r['fast']/m:.2f} | "+" ".join(f"{x:.2f}" for x in row))
    tab.append(row)
tab=np.array(tab)
for t,c in zip(taus,tab.T): print(t,"median %.3f p95 %.3f max %.2f"%(np.median(c),np.percentile(c,95),c.max()))
